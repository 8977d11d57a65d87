tai.tree @t : !tai.root<dense<[i: 64], {x: f32, y: f32}>, {n: i32, loss: f32, "loss.grad": f32}>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 0
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @loss.grad
tai.field @loss.grad = @t["loss.grad"] : f32, rank 0

// A local, a branch that can be flattened, an angle of zeros, a lossy cast.
tai.kernel @branches(%a: f32, %c: i1) {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %s = tai.alloca : !tai.local<f32>
    %0 = tai.load @x[%i] : f32
    tai.local_store %0, %s : f32
    scf.if %c {
      %1 = arith.addf %0, %a : f32
      tai.local_store %1, %s : f32
    }
    %2 = scf.if %c -> f32 {
      scf.yield %a : f32
    } else {
      %3 = arith.mulf %a, %0 : f32
      scf.yield %3 : f32
    }
    %4 = math.atan2 %zero, %zero : f32
    %5 = tai.local_load %s : f32
    %6 = arith.addf %5, %2 : f32
    %7 = arith.addf %6, %4 : f32
    tai.store %7, @y[%i] : f32
  }
  tai.return
}

// Indices that a launch checks, an update that one iteration makes, a sum.
tai.kernel @indices(%n: index, %k: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.addi %i, %k : index
    %1 = tai.load @x[%0] : f32
    %2 = tai.atomic add %1, @y[%i] : f32
    %3 = tai.atomic add %1, @loss[] : f32
  }
  tai.return
}

// Vectors, and an element that a serial loop updates.
tai.kernel @vectors(%a: vector<3xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %0 = arith.addf %a, %a : vector<3xf32>
  %1 = tai.dot %0, %a : vector<3xf32>
  scf.for %i = %c0 to %n step %c1 {
    %2 = tai.load @loss[] : f32
    %3 = arith.mulf %2, %1 : f32
    tai.store %3, @loss[] : f32
  }
  tai.return
}
