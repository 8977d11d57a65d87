// Row: func | a function that calls itself with other numbers, reads an array before and writes one after
func.func private @walk(%x: memref<8xf64>, %y: memref<8xf64>, %a: f64, %n: index) -> f64 {
  %c1 = arith.constant 1 : index
  %c6 = arith.constant 6 : index
  %v = memref.load %x[%n] : memref<8xf64>
  %t = arith.mulf %a, %v : f64
  %s = math.sin %t : f64
  %more = arith.cmpi slt, %n, %c6 : index
  %r = scf.if %more -> f64 {
    %w = math.cos %v : f64
    %m = arith.addi %n, %c1 : index
    %big = arith.cmpf ogt, %s, %a : f64
    %q = scf.if %big -> f64 {
      %z = arith.mulf %s, %w : f64
      scf.yield %z : f64
    } else {
      scf.yield %s : f64
    }
    %p = func.call @walk(%x, %y, %q, %m) : (memref<8xf64>, memref<8xf64>, f64, index) -> f64
    %u = arith.mulf %p, %w : f64
    memref.store %u, %y[%n] : memref<8xf64>
    %d = arith.addf %u, %a : f64
    scf.yield %d : f64
  } else {
    memref.store %s, %y[%n] : memref<8xf64>
    scf.yield %s : f64
  }
  %e = arith.mulf %r, %s : f64
  return %e : f64
}
func.func @f(%x: memref<8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c7 = arith.constant 7 : index
  %a = memref.load %x[%c0] : memref<8xf64>
  %b = func.call @walk(%x, %y, %a, %c0) : (memref<8xf64>, memref<8xf64>, f64, index) -> f64
  memref.store %b, %y[%c7] : memref<8xf64>
  return
}
