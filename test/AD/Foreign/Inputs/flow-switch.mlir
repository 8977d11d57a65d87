// Row: cf | `cf.switch`
func.func @f(%x: memref<3xf64>, %y: memref<3xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %a = memref.load %x[%c0] : memref<3xf64>
  %k = arith.fptosi %a : f64 to i32
  cf.switch %k : i32, [
    default: ^bb1,
    0: ^bb2
  ]
^bb1:
  %b = arith.mulf %a, %a : f64
  cf.br ^bb3(%b : f64)
^bb2:
  %d = math.exp %a : f64
  cf.br ^bb3(%d : f64)
^bb3(%v: f64):
  memref.store %v, %y[%c1] : memref<3xf64>
  return
}
