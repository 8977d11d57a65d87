// Row: func | `func.call` of a function that calls itself
func.func private @power(%a: f64, %n: index) -> f64 {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %one = arith.constant 1.0 : f64
  %z = arith.cmpi eq, %n, %c0 : index
  %r = scf.if %z -> f64 {
    scf.yield %one : f64
  } else {
    %m = arith.subi %n, %c1 : index
    %p = func.call @power(%a, %m) : (f64, index) -> f64
    %q = arith.mulf %p, %a : f64
    scf.yield %q : f64
  }
  return %r : f64
}
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = func.call @power(%a, %c3) : (f64, index) -> f64
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
