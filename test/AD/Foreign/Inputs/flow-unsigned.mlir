// Row: scf | `scf.for unsigned`
func.func @f(%x: memref<8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c1 = arith.constant 1 : i32
  %c8 = arith.constant 8 : i32
  %c3 = arith.constant 3 : i32
  %one = arith.constant 1.0 : f64
  %p = scf.for unsigned %i = %c1 to %c8 step %c3 iter_args(%q = %one) -> f64 : i32 {
    %j = arith.index_cast %i : i32 to index
    %a = memref.load %x[%j] : memref<8xf64>
    %b = arith.mulf %a, %q : f64
    memref.store %b, %y[%j] : memref<8xf64>
    scf.yield %b : f64
  }
  %c0 = arith.constant 0 : index
  memref.store %p, %y[%c0] : memref<8xf64>
  return
}
