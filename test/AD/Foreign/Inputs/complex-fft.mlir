// Row: complex | a Fourier transform by `complex.exp`, `complex.mul`, sums carried by loops
func.func @f(%x: memref<4x2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %zero = arith.constant 0.0 : f64
  %w = arith.constant -1.5707963267948966 : f64
  %z = complex.create %zero, %zero : complex<f64>
  %t = memref.alloca() : memref<4x2xf64>
  scf.for %k = %c0 to %c4 step %c1 {
    %s = scf.for %n = %c0 to %c4 step %c1 iter_args(%sum = %z) -> complex<f64> {
      %re = memref.load %x[%n, %c0] : memref<4x2xf64>
      %im = memref.load %x[%n, %c1] : memref<4x2xf64>
      %v = complex.create %re, %im : complex<f64>
      %v2 = complex.mul %v, %v : complex<f64>
      %kn = arith.muli %k, %n : index
      %i = arith.index_cast %kn : index to i64
      %fi = arith.sitofp %i : i64 to f64
      %p = arith.mulf %fi, %w : f64
      %pc = complex.create %zero, %p : complex<f64>
      %e = complex.exp %pc : complex<f64>
      %m = complex.mul %v2, %e : complex<f64>
      %a = complex.add %sum, %m : complex<f64>
      scf.yield %a : complex<f64>
    }
    %re = complex.re %s : complex<f64>
    %im = complex.im %s : complex<f64>
    memref.store %re, %t[%k, %c0] : memref<4x2xf64>
    memref.store %im, %t[%k, %c1] : memref<4x2xf64>
  }
  memref.copy %t, %x : memref<4x2xf64> to memref<4x2xf64>
  return
}
