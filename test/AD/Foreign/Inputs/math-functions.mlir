// Row: math | `log1p`, `expm1`, `atan2`, `powf`, `fpowi`, `cbrt`, `exp2`, `log2`, `log10`, `floor`, `ceil`, `asinh`, `roundeven`
func.func @f(%x: memref<6xf64>, %y: memref<6xf64>, %n: i32) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c6 = arith.constant 6 : index
  scf.for %i = %c0 to %c6 step %c1 {
    %a = memref.load %x[%i] : memref<6xf64>
    %b = memref.load %y[%i] : memref<6xf64>
    %p = math.absf %a : f64
    %0 = math.log1p %p : f64
    %1 = math.expm1 %b : f64
    %2 = math.atan2 %0, %1 : f64
    %3 = math.powf %p, %b : f64
    %4 = math.fpowi %a, %n : f64, i32
    %5 = math.cbrt %a : f64
    %6 = math.exp2 %b : f64
    %7 = math.log2 %p : f64
    %8 = math.log10 %6 : f64
    %9 = math.floor %a : f64
    %10 = math.asinh %5 : f64
    %11 = math.roundeven %b : f64
    %12 = math.tan %2 : f64
    %13 = arith.addf %12, %3 : f64
    %14 = arith.mulf %13, %4 : f64
    %15 = arith.addf %14, %7 : f64
    %16 = arith.mulf %8, %9 : f64
    %17 = arith.mulf %10, %11 : f64
    %18 = arith.addf %16, %17 : f64
    %19 = arith.subf %15, %18 : f64
    %20 = math.sin %19 : f64
    memref.store %20, %y[%i] : memref<6xf64>
    memref.store %19, %x[%i] : memref<6xf64>
  }
  return
}
