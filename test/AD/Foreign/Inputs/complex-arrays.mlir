// Row: complex | memrefs of complex numbers
func.func @f(%x: memref<3xcomplex<f64>>, %y: memref<3xcomplex<f64>>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  scf.for %i = %c0 to %c3 step %c1 {
    %a = memref.load %x[%i] : memref<3xcomplex<f64>>
    %b = complex.mul %a, %a : complex<f64>
    memref.store %b, %y[%i] : memref<3xcomplex<f64>>
  }
  return
}
