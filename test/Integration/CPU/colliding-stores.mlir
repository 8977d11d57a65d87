// RUN: tai-run %s
// RUN: tai-run %s --deterministic --threads=1 --debug

// The gradient of stores that collide is that of the last one, in each of
// several time steps.

tai.tree @data : !tai.root<
    dense<[i: 64], {x: f64, x_grad: f64, at: i32}>,
    dense<[i: 4, j: 8], {y: f64, y_grad: f64}>,
    {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @y_grad = @data["y_grad"] : f64, rank 2
tai.field @y = @data["y"] : f64, rank 2, adjoint @y_grad
tai.field @at = @data["at"] : i32, rank 1
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @fill() {
  %c5 = arith.constant 5 : i32
  %c8 = arith.constant 8 : i32
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %v = arith.sitofp %n : i32 to f64
    %s = math.sin %v : f64
    tai.store %s, @x[%i] : f64
    %m = arith.muli %n, %c5 : i32
    %k = arith.remsi %m, %c8 : i32
    tai.store %k, @at[%i] : i32
  }
  tai.return
}

tai.kernel @steps(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %t = %c0 to %n step %c1 {
    tai.parallel_for (%i) in @x {
      %k = tai.load @at[%i] : i32
      %j = arith.index_cast %k : i32 to index
      %v = tai.load @x[%i] : f64
      %e = math.exp %v : f64
      %r = arith.index_cast %t : index to i32
      %f = arith.sitofp %r : i32 to f64
      %p = arith.mulf %e, %f : f64
      tai.store %p, @y[%t, %j] : f64
    }
  }
  tai.return
}

tai.kernel @total() {
  tai.parallel_for (%t, %j) in @y {
    %v = tai.load @y[%t, %j] : f64
    %s = arith.mulf %v, %v : f64
    %old = tai.atomic add %s, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %c4 = arith.constant 4 : index
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-6 {
    %zero = arith.constant 0.0 : f64
    tai.store %zero, @loss[] : f64
    tai.launch @steps(%c4) : (index) -> ()
    tai.launch @total() : () -> ()
  }
  return
}
