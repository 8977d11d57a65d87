// RUN: not tai-run %s 2>&1 | FileCheck %s

tai.tree @t : !tai.root<pointer<[i: 4], {x: f64, x_grad: f64}>>
tai.tree @s : !tai.root<{loss: f64, loss_grad: f64}>
tai.field @x_grad = @t["x_grad"] : f64, rank 1
tai.field @x = @t["x"] : f64, rank 1, adjoint @x_grad
tai.field @loss_grad = @s["loss_grad"] : f64, rank 0
tai.field @loss = @s["loss"] : f64, rank 0, adjoint @loss_grad
tai.kernel @sum() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %old = tai.atomic add %v, @loss[] : f64
  }
  tai.return
}
func.func @main() {
  // CHECK: [[@LINE+1]]:3: error: a gradient is checked on copies of all trees, and tree 't' has sparse levels; compare with 'tai_check.close' instead
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
    tai.launch @sum() : () -> ()
  }
  return
}
