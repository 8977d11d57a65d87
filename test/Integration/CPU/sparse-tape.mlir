// RUN: tai-run %s --no-cache

// A host program with a tape over a sparse field that grows while it records:
// the second loop goes over more cells than the first, in both directions.

tai.tree @t : !tai.root<pointer<[i: 8], dense<[i: 2], {x: f64, x_grad: f64}>>>
tai.tree @d : !tai.root<dense<[i: 16], {y: f64, y_grad: f64}>>
tai.tree @s : !tai.root<{loss: f64, loss_grad: f64}>
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @y_grad = @d["y_grad"] : f64, rank 1
tai.field @y = @d["y"] : f64, rank 1, adjoint @y_grad
tai.field @loss_grad = @s["loss_grad"] : f64, rank 0
tai.field @loss = @s["loss"] : f64, rank 0, adjoint @loss_grad
tai.kernel @start() {
  %v = arith.constant 3.0 : f64
  tai.parallel_for (%i) in @y { tai.store %v, @y[%i] : f64 }
  tai.return
}
tai.kernel @fill(%n: i32) {
  %v = arith.constant 1.5 : f64
  %c0 = arith.constant 0 : index
  %end = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%c0) to (%end) { tai.store %v, @x[%i] : f64 }
  tai.return
}
// Where x is active, y is overwritten.
tai.kernel @square() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %y = tai.load @y[%i] : f64
    %p = arith.mulf %v, %y : f64
    tai.store %p, @y[%i] : f64
  }
  tai.return
}
tai.kernel @sum() {
  tai.parallel_for (%i) in @y {
    %v = tai.load @y[%i] : f64
    %old = tai.atomic add %v, @loss[] : f64
  }
  tai.return
}
tai.kernel @slope(%n: i32) -> f64 {
  %i = arith.index_cast %n : i32 to index
  %0 = tai.load @y_grad[%i] : f64
  tai.return %0 : f64
}
func.func @main() {
  %four = arith.constant 4 : i32
  %eight = arith.constant 8 : i32
  tai.launch @start() : () -> ()
  tai.launch @fill(%four) : (i32) -> ()
  tai.tape loss(@loss) {
    tai.launch @square() : () -> ()
    tai.launch @fill(%eight) : (i32) -> ()
    tai.launch @square() : () -> ()
    tai.launch @sum() : () -> ()
  }
  %three = arith.constant 3 : i32
  %five = arith.constant 5 : i32
  %nine = arith.constant 9 : i32
  %0 = tai.launch @slope(%three) : (i32) -> f64
  %1 = tai.launch @slope(%five) : (i32) -> f64
  %2 = tai.launch @slope(%nine) : (i32) -> f64
  %twice = arith.constant 2.25 : f64
  %once = arith.constant 1.5 : f64
  %one = arith.constant 1.0 : f64
  tai_check.close %0, %twice tolerance 1.0e-15 : f64
  tai_check.close %1, %once tolerance 1.0e-15 : f64
  tai_check.close %2, %one tolerance 1.0e-15 : f64
  return
}
