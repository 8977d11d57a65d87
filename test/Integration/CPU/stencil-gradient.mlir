// RUN: tai-run %s
// RUN: tai-run %s --opt-level=0
// RUN: tai-run %s --deterministic --threads=2

// Gradients of stencils, which are gathered instead of scattered: wrapped around
// the end along j, cut off at the border along i, in time slots.

tai.tree @grid : !tai.root<
  dense<[i: 3], dense<[j: 21, k: 37], {u: f64, u_grad: f64}>>,
  dense<[i: 21, j: 37], {x: f64, x_grad: f64}>,
  {loss: f64, loss_grad: f64}>
tai.field @x_grad = @grid["x_grad"] : f64, rank 2
tai.field @x = @grid["x"] : f64, rank 2, adjoint @x_grad
tai.field @u_grad = @grid["u_grad"] : f64, rank 3
tai.field @u = @grid["u"] : f64, rank 3, adjoint @u_grad
tai.field @loss_grad = @grid["loss_grad"] : f64, rank 0
tai.field @loss = @grid["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @fill() {
  %c0 = arith.constant 0 : index
  %third = arith.constant 0.37 : f64
  %c21 = arith.constant 21 : index
  %c37 = arith.constant 37 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c21, %c37) {
    %i32 = arith.index_cast %i : index to i32
    %j32 = arith.index_cast %j : index to i32
    %x = arith.sitofp %i32 : i32 to f64
    %y = arith.sitofp %j32 : i32 to f64
    %a = math.fma %x, %third, %y : f64
    %s = math.sin %a : f64
    tai.store %s, @x[%i, %j] : f64
  }
  tai.return
}

tai.kernel @start() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i, %j) in @x {
    %x = tai.load @x[%i, %j] : f64
    tai.store %x, @u[%c0, %i, %j] : f64
  }
  tai.return
}

// u[t, i, j] = sin(u[t-1, i, (j+1) mod 37] * u[t-1, i, (j-2) mod 37])
//            + (i > 0 ? u[t-1, i-1, j]^2 : 0) + 0.5 u[t-1, i, j]
tai.kernel @step(%t: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c21 = arith.constant 21 : index
  %c37 = arith.constant 37 : index
  %one = arith.constant 1 : i32
  %two = arith.constant 2 : i32
  %n = arith.constant 37 : i32
  %half = arith.constant 0.5 : f64
  %zero = arith.constant 0.0 : f64
  %now = arith.index_cast %t : i32 to index
  %before_i32 = arith.subi %t, %one : i32
  %before = arith.index_cast %before_i32 : i32 to index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c21, %c37) {
    %j32 = arith.index_cast %j : index to i32
    %up = arith.addi %j32, %one : i32
    %up_wrapped = arith.remsi %up, %n : i32
    %up_index = arith.index_cast %up_wrapped : i32 to index
    %down = arith.subi %j32, %two : i32
    %turns = arith.floordivsi %down, %n : i32
    %full = arith.muli %turns, %n : i32
    %down_wrapped = arith.subi %down, %full : i32
    %down_index = arith.index_cast %down_wrapped : i32 to index
    %a = tai.load @u[%before, %i, %up_index] : f64
    %b = tai.load @u[%before, %i, %down_index] : f64
    %ab = arith.mulf %a, %b : f64
    %s = math.sin %ab : f64
    %inside = arith.cmpi sgt, %i, %c0 : index
    %border = scf.if %inside -> (f64) {
      %above = arith.subi %i, %c1 : index
      %c = tai.load @u[%before, %above, %j] : f64
      %cc = arith.mulf %c, %c : f64
      scf.yield %cc : f64
    } else {
      scf.yield %zero : f64
    }
    %d = tai.load @u[%before, %i, %j] : f64
    %dd = arith.mulf %d, %half : f64
    %sum = arith.addf %s, %border : f64
    %total = arith.addf %sum, %dd : f64
    tai.store %total, @u[%now, %i, %j] : f64
  }
  tai.return
}

tai.kernel @measure() {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %c21 = arith.constant 21 : index
  %c37 = arith.constant 37 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c21, %c37) {
    %u = tai.load @u[%c2, %i, %j] : f64
    %uu = arith.mulf %u, %u : f64
    %old = tai.atomic add %uu, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %c1 = arith.constant 1 : i32
  %c2 = arith.constant 2 : i32
  %zero = arith.constant 0.0 : f64
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @start() : () -> ()
    tai.launch @step(%c1) : (i32) -> ()
    tai.launch @step(%c2) : (i32) -> ()
    tai.launch @measure() : () -> ()
  }
  return
}
