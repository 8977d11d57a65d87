// Row: in place | steps within `tai.trace_bytes`, whose inner loop is divided as well
func.func @f(%x: memref<4xf64>) attributes {tai.differentiate, tai.trace_bytes = 700 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %c3 = arith.constant 3 : index
  %c30 = arith.constant 30 : index
  %h = arith.constant 0.1 : f64
  scf.for %s = %c0 to %c3 step %c1 {
    scf.for %t = %c0 to %c30 step %c1 {
      scf.for %i = %c0 to %c4 step %c1 {
        %a = memref.load %x[%i] : memref<4xf64>
        %q = arith.mulf %a, %a : f64
        %u = math.sin %q : f64
        %v = arith.mulf %u, %h : f64
        %b = arith.subf %a, %v : f64
        memref.store %b, %x[%i] : memref<4xf64>
      }
    }
  }
  return
}
