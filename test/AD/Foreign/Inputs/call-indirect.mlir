// Row: func | `call_indirect` of a known function
func.func private @sine(%x: f64) -> f64 {
  %a = math.sin %x : f64
  return %a : f64
}
func.func @f(%x: memref<5xf64>, %y: memref<5xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %g = constant @sine : (f64) -> f64
  %u = memref.load %x[%c0] : memref<5xf64>
  %v = call_indirect %g(%u) : (f64) -> f64
  memref.store %v, %y[%c0] : memref<5xf64>
  return
}
