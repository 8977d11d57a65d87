// Row: arith | `extf`, `truncf`, `select`, `minimumf`, `uitofp`, `math.copysign`
func.func @f(%x: memref<4xf32>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %h = arith.constant 0.3 : f64
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf32>
    %b = arith.extf %a : f32 to f64
    %c = arith.minimumf %b, %h : f64
    %k = arith.index_castui %i : index to i64
    %kf = arith.uitofp %k : i64 to f64
    %d = arith.mulf %c, %kf : f64
    %p = arith.cmpf ogt, %b, %h : f64
    %e = arith.select %p, %d, %b : f64
    %t = arith.truncf %e : f64 to f32
    %g = math.copysign %t, %a : f32
    %z = arith.extf %g : f32 to f64
    %old = memref.load %y[%i] : memref<4xf64>
    %s = arith.mulf %z, %old : f64
    memref.store %s, %y[%i] : memref<4xf64>
  }
  return
}
