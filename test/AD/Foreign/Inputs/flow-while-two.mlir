// Row: scf | `scf.while` that carries two numbers and a counter, and changes an array
func.func @f(%x: memref<4xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %one = arith.constant 1.0 : f64
  %big = arith.constant 40.0 : f64
  %a0 = memref.load %x[%c0] : memref<4xf64>
  %r:3 = scf.while (%a = %a0, %b = %one, %k = %c0) : (f64, f64, index) -> (f64, f64, index) {
    %near = arith.cmpi slt, %k, %c3 : index
    %aa = math.absf %a : f64
    %small = arith.cmpf olt, %aa, %big : f64
    %go = arith.andi %near, %small : i1
    scf.condition(%go) %b, %a, %k : f64, f64, index
  } do {
  ^bb0(%b: f64, %a: f64, %k: index):
    %next = arith.addi %k, %c1 : index
    %v = memref.load %x[%next] : memref<4xf64>
    %p = arith.mulf %a, %v : f64
    %q = arith.addf %p, %b : f64
    memref.store %q, %x[%next] : memref<4xf64>
    scf.yield %q, %a, %next : f64, f64, index
  }
  memref.store %r#0, %y[%c0] : memref<2xf64>
  memref.store %r#1, %y[%c1] : memref<2xf64>
  return
}
