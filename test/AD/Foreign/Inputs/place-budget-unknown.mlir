// Row: in place | steps within `tai.trace_bytes`, whose numbers are known at run time
func.func @f(%x: memref<?xf64>, %n: index) attributes {tai.differentiate, tai.trace_bytes = 250 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %h = arith.constant 0.1 : f64
  %m = memref.dim %x, %c0 : memref<?xf64>
  scf.for %s = %c0 to %n step %c1 {
    scf.for %i = %c0 to %m step %c1 {
      %a = memref.load %x[%i] : memref<?xf64>
      %b = arith.mulf %a, %a : f64
      %u = math.sin %b : f64
      memref.store %u, %x[%i] : memref<?xf64>
    }
    scf.for %i = %c0 to %m step %c1 {
      %a = memref.load %x[%i] : memref<?xf64>
      %q = arith.mulf %a, %a : f64
      %v = arith.mulf %q, %h : f64
      %b = arith.subf %a, %v : f64
      memref.store %b, %x[%i] : memref<?xf64>
    }
  }
  return
}
