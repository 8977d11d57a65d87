// RUN: tai-run %s --no-cache --threads=1
// RUN: tai-run %s --no-cache --deterministic
// RUN: sed -e 's/wrt \[@x\] tolerance/wrt [@y] tolerance/' %s | not tai-run - --no-cache 2>&1 | FileCheck %s

// In a field with a time axis all steps but the first are overwritten before
// they are read. Their adjoints are right, and differences of their former
// values show nothing: the check leaves them out. Elements that are updated in
// place are read first, and are checked. Written with the former names of
// checks, as programs outside of this tree are.
// CHECK: nothing is checked: all elements of 'y' are overwritten before they are read
tai.tree @t : !tai.root<dense<[i: 6, j: 3], {x: f64, gx: f64}>,
                        dense<[i: 4], {y: f64, gy: f64}>, {loss: f64, gl: f64}>
tai.field @gx = @t["gx"] : f64, rank 2
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @gl = @t["gl"] : f64, rank 0
tai.field @x = @t["x"] : f64, rank 2, adjoint @gx
tai.field @y = @t["y"] : f64, rank 1, adjoint @gy
tai.field @loss = @t["loss"] : f64, rank 0, adjoint @gl

tai.kernel @start() {
  tai.parallel_for (%i, %j) in @x {
    %n = arith.index_cast %j : index to i64
    %f = arith.sitofp %n : i64 to f64
    %s = math.cos %f : f64
    tai.store %s, @x[%i, %j] : f64
  }
  tai.return
}
// x[t + 1] = sin(x[t]) + 0.5 x[t], and x[0] doubled in place before.
tai.kernel @double() {
  %c0 = arith.constant 0 : index
  %c3 = arith.constant 3 : index
  %two = arith.constant 2.0 : f64
  tai.parallel_for (%j) = (%c0) to (%c3) {
    %0 = tai.load @x[%c0, %j] : f64
    %1 = arith.mulf %0, %two : f64
    tai.store %1, @x[%c0, %j] : f64
  }
  tai.return
}
tai.kernel @step(%t: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %half = arith.constant 0.5 : f64
  %from = arith.index_cast %t : i32 to index
  %to = arith.addi %from, %c1 : index
  tai.parallel_for (%j) = (%c0) to (%c3) {
    %0 = tai.load @x[%from, %j] : f64
    %1 = math.sin %0 : f64
    %2 = arith.mulf %0, %half : f64
    %3 = arith.addf %1, %2 : f64
    tai.store %3, @x[%to, %j] : f64
  }
  tai.return
}
tai.kernel @sum() {
  %c0 = arith.constant 0 : index
  %c3 = arith.constant 3 : index
  %c5 = arith.constant 5 : index
  tai.parallel_for (%j) = (%c0) to (%c3) {
    %0 = tai.load @x[%c5, %j] : f64
    %1 = arith.mulf %0, %0 : f64
    %2 = tai.atomic add %1, @loss[] : f64
  }
  tai.return
}
tai.kernel @clear() {
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @y {
    tai.store %zero, @y[%i] : f64
  }
  tai.return
}
func.func @main() {
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1.0 : f64
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c5 = arith.constant 5 : index
  tai.launch @start() : () -> ()
  tai.store %one, @y[%c3] : f64
  tai.check_gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.store %zero, @loss[] : f64
    tai.launch @clear() : () -> ()
    tai.launch @double() : () -> ()
    scf.for %i = %c0 to %c5 step %c1 {
      %t = arith.index_cast %i : index to i32
      tai.launch @step(%t) : (i32) -> ()
    }
    tai.launch @sum() : () -> ()
  }
  return
}
