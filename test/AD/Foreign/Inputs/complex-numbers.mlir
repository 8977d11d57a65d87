// Row: complex | `complex.create`, `mul`, `re`, `im`, `abs`
func.func @f(%x: memref<4xf64>, %y: memref<3xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %a = memref.load %x[%c0] : memref<4xf64>
  %b = memref.load %x[%c1] : memref<4xf64>
  %c = memref.load %x[%c2] : memref<4xf64>
  %d = memref.load %x[%c3] : memref<4xf64>
  %z = complex.create %a, %b : complex<f64>
  %w = complex.create %c, %d : complex<f64>
  %p = complex.mul %z, %w : complex<f64>
  %e = complex.exp %p : complex<f64>
  %re = complex.re %e : complex<f64>
  %im = complex.im %e : complex<f64>
  %q = complex.div %z, %w : complex<f64>
  %s = complex.abs %q : complex<f64>
  memref.store %re, %y[%c0] : memref<3xf64>
  memref.store %im, %y[%c1] : memref<3xf64>
  memref.store %s, %y[%c2] : memref<3xf64>
  return
}
