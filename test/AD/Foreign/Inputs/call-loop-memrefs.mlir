// Row: func | a private function of a memref and a number called in a loop, in place, with a nested call
func.func private @kick(%v: f64, %h: f64) -> f64 {
  %s = math.sin %v : f64
  %t = arith.mulf %s, %h : f64
  return %t : f64
}
func.func private @step(%x: memref<4xf64>, %h: f64) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %k = func.call @kick(%a, %h) : (f64, f64) -> f64
    %b = arith.subf %a, %k : f64
    memref.store %b, %x[%i] : memref<4xf64>
  }
  return
}
func.func @f(%x: memref<4xf64>, %h: f64) attributes {tai.differentiate, tai.gradients = array<i64: 0, 1>} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  scf.for %t = %c0 to %c5 step %c1 {
    func.call @step(%x, %h) : (memref<4xf64>, f64) -> ()
  }
  return
}
