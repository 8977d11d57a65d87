// Row: scf | `scf.index_switch`
func.func @f(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = scf.index_switch %i -> f64
    case 0 {
      %0 = arith.mulf %a, %a : f64
      scf.yield %0 : f64
    }
    case 2 {
      %0 = math.sin %a : f64
      scf.yield %0 : f64
    }
    default {
      %0 = math.exp %a : f64
      scf.yield %0 : f64
    }
    memref.store %b, %y[%i] : memref<4xf64>
  }
  return
}
