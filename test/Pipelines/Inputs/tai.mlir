// Code of tai that stands in a module with others.
tai.tree @t : !tai.root<dense<[i: 16], {x: f64, xg: f64, l: f64, lg: f64}>>
tai.field @tai_x = @t["x"] : f64, rank 1, adjoint @tai_xg
tai.field @tai_xg = @t["xg"] : f64, rank 1
tai.field @tai_l = @t["l"] : f64, rank 1, adjoint @tai_lg
tai.field @tai_lg = @t["lg"] : f64, rank 1
tai.kernel @tai_sum() {
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) in @tai_x {
    %0 = tai.load @tai_x[%i] : f64
    %1 = func.call @helper(%0, %0) : (f64, f64) -> f64
    %2 = arith.mulf %1, %0 : f64
    %3 = tai.atomic add %2, @tai_l[%zero] : f64
  }
  tai.return
}
func.func @tai_cube(%m: memref<f64>, %out: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %m[] : memref<f64>
  %1 = func.call @helper(%0, %0) : (f64, f64) -> f64
  %2 = arith.mulf %1, %0 : f64
  memref.store %2, %out[] : memref<f64>
  return
}
func.func private @tai_private(%m: memref<f64>, %out: memref<f64>) attributes {tai.differentiate} {
  %0 = memref.load %m[] : memref<f64>
  %1 = arith.mulf %0, %0 : f64
  memref.store %1, %out[] : memref<f64>
  return
}
func.func @tai_main() {
  tai.launch @tai_sum() : () -> ()
  return
}
