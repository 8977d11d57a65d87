// Row: complex | `complex.pow`, `powi`, `sign`, `tanh`
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %three = arith.constant 3 : i32
  %a = memref.load %x[%c0] : memref<4xf64>
  %b = memref.load %x[%c1] : memref<4xf64>
  %c = memref.load %x[%c2] : memref<4xf64>
  %d = memref.load %x[%c3] : memref<4xf64>
  %z = complex.create %a, %b : complex<f64>
  %w = complex.create %c, %d : complex<f64>
  %p = complex.pow %z, %w : complex<f64>
  %q = complex.powi %z, %three : complex<f64>, i32
  %s = complex.sign %w : complex<f64>
  %t = complex.tanh %w : complex<f64>
  %pre = complex.re %p : complex<f64>
  %qim = complex.im %q : complex<f64>
  %sre = complex.re %s : complex<f64>
  %tim = complex.im %t : complex<f64>
  memref.store %pre, %y[%c0] : memref<4xf64>
  memref.store %qim, %y[%c1] : memref<4xf64>
  memref.store %sre, %y[%c2] : memref<4xf64>
  memref.store %tim, %y[%c3] : memref<4xf64>
  return
}
