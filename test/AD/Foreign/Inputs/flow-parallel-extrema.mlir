// Row: scf | `scf.parallel` that reduces a minimum and a maximum
func.func @f(%x: memref<5xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  %big = arith.constant 1.0e30 : f64
  %small = arith.constant -1.0e30 : f64
  %r:2 = scf.parallel (%i) = (%c0) to (%c5) step (%c1) init (%big, %small) -> (f64, f64) {
    %a = memref.load %x[%i] : memref<5xf64>
    %b = arith.mulf %a, %a : f64
    scf.reduce(%a, %b : f64, f64) {
    ^bb0(%l: f64, %q: f64):
      %s = arith.minimumf %l, %q : f64
      scf.reduce.return %s : f64
    }, {
    ^bb0(%l: f64, %q: f64):
      %s = arith.maximumf %l, %q : f64
      scf.reduce.return %s : f64
    }
  }
  memref.store %r#0, %y[%c0] : memref<2xf64>
  memref.store %r#1, %y[%c1] : memref<2xf64>
  return
}
