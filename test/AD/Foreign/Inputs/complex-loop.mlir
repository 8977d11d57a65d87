// Row: complex | complex numbers carried by a loop: `mul`, `add`, `neg`, `conj`, `div`
func.func @f(%x: memref<4xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
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
  %r = scf.for %i = %c0 to %c3 step %c1 iter_args(%v = %z) -> complex<f64> {
    %p = complex.mul %v, %w : complex<f64>
    %q = complex.add %p, %z : complex<f64>
    %n = complex.neg %q : complex<f64>
    scf.yield %n : complex<f64>
  }
  %s = complex.conj %r : complex<f64>
  %t = complex.div %s, %w : complex<f64>
  %re = complex.re %t : complex<f64>
  %im = complex.im %t : complex<f64>
  memref.store %re, %y[%c0] : memref<2xf64>
  memref.store %im, %y[%c1] : memref<2xf64>
  return
}
