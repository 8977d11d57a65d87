// Row: scf | `scf.index_switch` with two results, nested in `scf.if` with results
func.func @f(%x: memref<6xf64>, %y: memref<6xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c6 = arith.constant 6 : index
  scf.for %i = %c0 to %c6 step %c1 {
    %a = memref.load %x[%i] : memref<6xf64>
    %b = memref.load %y[%i] : memref<6xf64>
    %low = arith.cmpi ult, %i, %c2 : index
    %r:2 = scf.if %low -> (f64, f64) {
      scf.yield %b, %a : f64, f64
    } else {
      %s:2 = scf.index_switch %i -> f64, f64
      case 3 {
        %p = arith.mulf %a, %b : f64
        %q = math.cos %a : f64
        scf.yield %p, %q : f64, f64
      }
      case 5 {
        scf.yield %a, %a : f64, f64
      }
      default {
        %p = arith.subf %a, %b : f64
        scf.yield %p, %b : f64, f64
      }
      %m = arith.mulf %s#0, %s#1 : f64
      scf.yield %m, %s#1 : f64, f64
    }
    memref.store %r#0, %x[%i] : memref<6xf64>
    memref.store %r#1, %y[%i] : memref<6xf64>
  }
  return
}
