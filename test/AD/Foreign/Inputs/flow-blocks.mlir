// Row: cf | `cf.br`, `cf.cond_br`: a loop of several blocks
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %zero = arith.constant 0.0 : f64
  cf.br ^head(%c0 : index)
^head(%i: index):
  %c = arith.cmpi slt, %i, %c4 : index
  cf.cond_br %c, ^body, ^exit
^body:
  %a = memref.load %x[%i] : memref<4xf64>
  %p = arith.cmpf ogt, %a, %zero : f64
  cf.cond_br %p, ^join(%a : f64), ^other
^other:
  %b = math.exp %a : f64
  cf.br ^join(%b : f64)
^join(%v: f64):
  %w = arith.mulf %v, %v : f64
  memref.store %w, %y[%i] : memref<4xf64>
  %n = arith.addi %i, %c1 : index
  cf.br ^head(%n : index)
^exit:
  return
}
