// RUN: tai-run %s --no-cache

// Loops whose bounds are further apart than their signed type has numbers: the
// gradient runs as many iterations as the loop did.

tai.tree @data : !tai.root<
    dense<[i: 4], {x: f64, x_grad: f64, y: f64, y_grad: f64}>,
    {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @y_grad = @data["y_grad"] : f64, rank 1
tai.field @y = @data["y"] : f64, rank 1, adjoint @y_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

// -128, -78, …, 72: five iterations.
tai.kernel @narrow() {
  %from = arith.constant -128 : i8
  %to = arith.constant 77 : i8
  %step = arith.constant 50 : i8
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %r = scf.for %j = %from to %to step %step iter_args(%v = %x) -> (f64) : i8 {
      %n = arith.sitofp %j : i8 to f64
      %p = arith.mulf %v, %x : f64
      %q = arith.addf %p, %n : f64
      %s = math.sin %q : f64
      scf.yield %s : f64
    }
    tai.store %r, @y[%i] : f64
  }
  tai.return
}

// Four iterations in 64 bits, none where the first bound is the greater one.
tai.kernel @wide(%from: index, %to: index) {
  %step = arith.constant 4000000000000000000 : index
  tai.parallel_for (%i) in @y {
    %y = tai.load @y[%i] : f64
    %x = tai.load @x[%i] : f64
    %r = scf.for %j = %from to %to step %step iter_args(%v = %y) -> (f64) {
      %p = arith.mulf %v, %x : f64
      %s = math.sin %p : f64
      scf.yield %s : f64
    }
    %old = tai.atomic add %r, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %least = arith.constant -9223372036854775800 : index
  %most = arith.constant 4223372036854775800 : index
  scf.for %i = %c0 to %c4 step %c1 {
    %n = arith.index_cast %i : index to i32
    %f = arith.sitofp %n : i32 to f64
    %v = math.cos %f : f64
    tai.store %v, @x[%i] : f64
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    %zero = arith.constant 0.0 : f64
    tai.store %zero, @loss[] : f64
    tai.launch @narrow() : () -> ()
    tai.launch @wide(%least, %most) : (index, index) -> ()
    tai.launch @wide(%most, %least) : (index, index) -> ()
  }
  return
}
