// Row: memref | `memref.atomic_rmw` of products and maxima in a parallel loop
func.func @f(%x: memref<4xf64>, %y: memref<2xf64>, %z: memref<f64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %k = arith.remsi %i, %c2 : index
    %a = memref.load %x[%i] : memref<4xf64>
    %0 = memref.atomic_rmw mulf %a, %y[%k] : (f64, memref<2xf64>) -> f64
    %1 = memref.atomic_rmw maximumf %a, %z[] : (f64, memref<f64>) -> f64
    scf.reduce
  }
  return
}
func.func @plain(%x: memref<4xf64>, %y: memref<2xf64>, %z: memref<f64>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %k = arith.remsi %i, %c2 : index
    %a = memref.load %x[%i] : memref<4xf64>
    %0 = memref.load %y[%k] : memref<2xf64>
    %1 = arith.mulf %0, %a : f64
    memref.store %1, %y[%k] : memref<2xf64>
    %2 = memref.load %z[] : memref<f64>
    %3 = arith.maximumf %2, %a : f64
    memref.store %3, %z[] : memref<f64>
  }
  return
}
