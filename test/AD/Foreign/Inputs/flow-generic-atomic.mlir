// Row: memref | `memref.generic_atomic_rmw`
func.func @f(%x: memref<4xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %k = arith.remsi %i, %c2 : index
    %a = memref.load %x[%i] : memref<4xf64>
    %o = memref.generic_atomic_rmw %y[%k] : memref<2xf64> {
    ^bb0(%old: f64):
      %s = arith.mulf %old, %a : f64
      %q = math.sin %s : f64
      memref.atomic_yield %q : f64
    }
  }
  return
}
func.func @plain(%x: memref<4xf64>, %y: memref<2xf64>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %k = arith.remsi %i, %c2 : index
    %a = memref.load %x[%i] : memref<4xf64>
    %old = memref.load %y[%k] : memref<2xf64>
    %s = arith.mulf %old, %a : f64
    %q = math.sin %s : f64
    memref.store %q, %y[%k] : memref<2xf64>
  }
  return
}
