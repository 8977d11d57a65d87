// y[i] = softplus(x[i]) times components 2 and 1 of (x, x^2) and (w, 3)
// interleaved, which are x^2 and w.

// CHECK-LABEL: func.func @f_grad(
//       CHECK:   scf.parallel
//       CHECK:     %[[E:.+]] = math.exp
//       CHECK:     %[[D:.+]] = arith.addf %[[E]]
//       CHECK:     arith.divf %{{.+}}, %[[D]]
//       CHECK:   return
func.func @f(%x: memref<4xf64>, %w: memref<4xf64>, %y: memref<4xf64>)
    attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %three = arith.constant 3.0 : f64
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %a = memref.load %x[%i] : memref<4xf64>
    %b = memref.load %w[%i] : memref<4xf64>
    %square = arith.mulf %a, %a : f64
    %u = vector.from_elements %a, %square : vector<2xf64>
    %v = vector.from_elements %b, %three : vector<2xf64>
    %z = vector.interleave %u, %v : vector<2xf64> -> vector<4xf64>
    %c = vector.extract %z[1] : f64 from vector<4xf64>
    %d = vector.extract %z[2] : f64 from vector<4xf64>
    %p = soft.plus %a : f64
    %q = arith.mulf %p, %d : f64
    %r = arith.mulf %q, %c : f64
    memref.store %r, %y[%i] : memref<4xf64>
  }
  return
}

func.func private @f_grad(%x: memref<4xf64>, %w: memref<4xf64>, %y: memref<4xf64>,
                          %gx: memref<4xf64>, %gw: memref<4xf64>, %gy: memref<4xf64>)

/// The numbers -3, -1, 1, 3.
func.func @point(%i: index) -> f64 {
  %two = arith.constant 2.0 : f64
  %three = arith.constant 3.0 : f64
  %n = arith.index_cast %i : index to i64
  %0 = arith.sitofp %n : i64 to f64
  %1 = arith.mulf %0, %two : f64
  %2 = arith.subf %1, %three : f64
  return %2 : f64
}

func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1.0 : f64
  %half = arith.constant 0.5 : f64
  %step = arith.constant 1.0e-5 : f64
  %bound = arith.constant 1.0e-7 : f64
  %x = memref.alloc() : memref<4xf64>
  %w = memref.alloc() : memref<4xf64>
  %y = memref.alloc() : memref<4xf64>
  %gx = memref.alloc() : memref<4xf64>
  %gw = memref.alloc() : memref<4xf64>
  %gy = memref.alloc() : memref<4xf64>
  scf.for %i = %c0 to %c4 step %c1 {
    %p = func.call @point(%i) : (index) -> f64
    memref.store %p, %x[%i] : memref<4xf64>
    memref.store %half, %w[%i] : memref<4xf64>
    memref.store %zero, %gx[%i] : memref<4xf64>
    memref.store %zero, %gw[%i] : memref<4xf64>
    memref.store %one, %gy[%i] : memref<4xf64>
  }
  func.call @f_grad(%x, %w, %y, %gx, %gw, %gy) : (memref<4xf64>, memref<4xf64>, memref<4xf64>, memref<4xf64>, memref<4xf64>, memref<4xf64>) -> ()
  scf.for %i = %c0 to %c4 step %c1 {
    %p = func.call @point(%i) : (index) -> f64
    %right = arith.addf %p, %step : f64
    memref.store %right, %x[%i] : memref<4xf64>
    func.call @f(%x, %w, %y) : (memref<4xf64>, memref<4xf64>, memref<4xf64>) -> ()
    %above = memref.load %y[%i] : memref<4xf64>
    %left = arith.subf %p, %step : f64
    memref.store %left, %x[%i] : memref<4xf64>
    func.call @f(%x, %w, %y) : (memref<4xf64>, memref<4xf64>, memref<4xf64>) -> ()
    %below = memref.load %y[%i] : memref<4xf64>
    %difference = arith.subf %above, %below : f64
    %width = arith.addf %step, %step : f64
    %slope = arith.divf %difference, %width : f64
    %found = memref.load %gx[%i] : memref<4xf64>
    %error = arith.subf %slope, %found : f64
    %size = math.absf %error : f64
    %good = arith.cmpf olt, %size, %bound : f64
    vector.print %good : i1
  }
  return
}
