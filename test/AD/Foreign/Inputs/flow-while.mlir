// Row: scf | `scf.while` over numbers
func.func @f(%x: memref<3xf64>, %y: memref<3xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %limit = arith.constant 20.0 : f64
  %two = arith.constant 2.0 : f64
  scf.for %i = %c0 to %c3 step %c1 {
    %a = memref.load %x[%i] : memref<3xf64>
    %r = scf.while (%s = %a) : (f64) -> f64 {
      %q = math.absf %s : f64
      %c = arith.cmpf olt, %q, %limit : f64
      scf.condition(%c) %s : f64
    } do {
    ^bb0(%s: f64):
      %p = arith.mulf %s, %s : f64
      %q = arith.addf %p, %two : f64
      scf.yield %q : f64
    }
    memref.store %r, %y[%i] : memref<3xf64>
  }
  return
}
