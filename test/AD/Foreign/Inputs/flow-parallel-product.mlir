// Row: scf | `scf.parallel` that reduces a product
func.func @f(%x: memref<5xf64>, %y: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  %one = arith.constant 1.0 : f64
  %r = scf.parallel (%i) = (%c0) to (%c5) step (%c1) init (%one) -> f64 {
    %a = memref.load %x[%i] : memref<5xf64>
    scf.reduce(%a : f64) {
    ^bb0(%l: f64, %q: f64):
      %s = arith.mulf %l, %q : f64
      scf.reduce.return %s : f64
    }
  }
  memref.store %r, %y[] : memref<f64>
  return
}
