// Row: func | a call of a function that has its own `tai.adjoint`
func.func private @square(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.adjoint = @square_rule} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
func.func private @square_rule(%x: memref<4xf64>, %y: memref<4xf64>, %dx: memref<4xf64>, %dy: memref<4xf64>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %two = arith.constant 2.0 : f64
  %zero = arith.constant 0.0 : f64
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %g = memref.load %dy[%i] : memref<4xf64>
    %t = arith.mulf %a, %two : f64
    %s = arith.mulf %t, %g : f64
    %o = memref.load %dx[%i] : memref<4xf64>
    %n = arith.addf %o, %s : f64
    memref.store %n, %dx[%i] : memref<4xf64>
    memref.store %zero, %dy[%i] : memref<4xf64>
  }
  return
}
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  call @square(%x, %y) : (memref<4xf64>, memref<4xf64>) -> ()
  return
}
