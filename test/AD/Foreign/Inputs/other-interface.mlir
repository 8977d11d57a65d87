// Row: func | `llvm.emit_c_interface`, numbers by `tai.gradients`
func.func @f(%a: f64, %b: f32, %x: memref<2xf64>) -> f64 attributes {tai.differentiate, llvm.emit_c_interface, tai.gradients = array<i64: 0, 1, 2, 3>} {
  %c0 = arith.constant 0 : index
  %v = memref.load %x[%c0] : memref<2xf64>
  %0 = arith.mulf %a, %v : f64
  %e = arith.extf %b : f32 to f64
  %1 = math.sin %0 : f64
  %2 = arith.mulf %1, %e : f64
  return %2 : f64
}
