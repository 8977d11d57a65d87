// Row: vector | `vector.scan` by products of rows in a loop, `multi_reduction` by a maximum
func.func @f(%x: memref<3x8xf64>, %y: memref<8xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %one = arith.constant dense<1.0> : vector<2xf64>
  %low = arith.constant dense<-1.0e30> : vector<4xf64>
  scf.for %i = %c0 to %c3 step %c1 {
    %a = vector.load %x[%i, %c0] : memref<3x8xf64>, vector<8xf64>
    %m = vector.shape_cast %a : vector<8xf64> to vector<2x4xf64>
    %s:2 = vector.scan <mul>, %m, %one {inclusive = true, reduction_dim = 1 : i64} : vector<2x4xf64>, vector<2xf64>
    %t = vector.multi_reduction <maximumf>, %s#0, %low [0] : vector<2x4xf64> to vector<4xf64>
    %u = vector.interleave %t, %t : vector<4xf64> -> vector<8xf64>
    %old = vector.load %y[%c0] : memref<8xf64>, vector<8xf64>
    %p = arith.mulf %u, %old : vector<8xf64>
    vector.store %p, %y[%c0] : memref<8xf64>, vector<8xf64>
  }
  return
}
func.func @plain(%x: memref<3x8xf64>, %y: memref<8xf64>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %low = arith.constant -1.0e30 : f64
  %one = arith.constant 1.0 : f64
  %t = memref.alloca() : memref<4xf64>
  scf.for %i = %c0 to %c3 step %c1 {
    scf.for %k = %c0 to %c4 step %c1 {
      memref.store %low, %t[%k] : memref<4xf64>
    }
    scf.for %r = %c0 to %c2 step %c1 {
      %p = scf.for %k = %c0 to %c4 step %c1 iter_args(%a = %one) -> f64 {
        %at0 = arith.muli %r, %c4 : index
        %at = arith.addi %at0, %k : index
        %v = memref.load %x[%i, %at] : memref<3x8xf64>
        %w = arith.mulf %a, %v : f64
        %old = memref.load %t[%k] : memref<4xf64>
        %m = arith.maximumf %old, %w : f64
        memref.store %m, %t[%k] : memref<4xf64>
        scf.yield %w : f64
      }
    }
    scf.for %k = %c0 to %c4 step %c1 {
      %v = memref.load %t[%k] : memref<4xf64>
      scf.for %r = %c0 to %c2 step %c1 {
        %at0 = arith.muli %k, %c2 : index
        %at = arith.addi %at0, %r : index
        %old = memref.load %y[%at] : memref<8xf64>
        %m = arith.mulf %v, %old : f64
        memref.store %m, %y[%at] : memref<8xf64>
      }
    }
  }
  return
}
