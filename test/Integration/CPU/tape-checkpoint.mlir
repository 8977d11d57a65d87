// RUN: tai-run %s --no-cache
// RUN: tai-run %s --no-cache --interpret
// RUN: sed -e 's/mixed budget 20000/binomial snapshots 5/' %s > %t.mlir && tai-run %t.mlir --no-cache
// RUN: sed -e 's/mixed budget 20000/periodic/' %s > %t.mlir && tai-run %t.mlir --no-cache
// RUN: tai-opt %s --tai-to-llvm | FileCheck %s

// A tape with a budget, as an attribute of the op: 1000 steps in place, x ← x − h x².
// CHECK: llvm.call @tai_rt_host_tape_checkpoint
// CHECK-NOT: llvm.call @tai_rt_host_tape_checkpoint

tai.tree @data : !tai.root<dense<[i: 64], {x: f64, x_grad: f64}>,
                           {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @start() {
  %one = arith.constant 1.0 : f64
  tai.parallel_for (%i) in @x { tai.store %one, @x[%i] : f64 }
  tai.return
}
tai.kernel @step() {
  %h = arith.constant 0.001 : f64
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %q = arith.mulf %v, %v : f64
    %d = arith.mulf %h, %q : f64
    %w = arith.subf %v, %d : f64
    tai.store %w, @x[%i] : f64
  }
  tai.return
}
tai.kernel @sum() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %old = tai.atomic add %v, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 1000 : index
  tai.launch @start() : () -> ()
  tai.tape loss(@loss) checkpoint(<mixed budget 20000>) {
    scf.for %t = %c0 to %n step %c1 { tai.launch @step() : () -> () }
    tai.launch @sum() : () -> ()
  }
  %with = tai.load @x_grad[%c0] : f64
  // All values saved: 512,000 bytes, and the same gradient to the last bit.
  tai.launch @start() : () -> ()
  tai.tape loss(@loss) {
    scf.for %t = %c0 to %n step %c1 { tai.launch @step() : () -> () }
    tai.launch @sum() : () -> ()
  }
  %without = tai.load @x_grad[%c0] : f64
  tai_check.close %with, %without tolerance 0.0 : f64
  return
}
