// RUN: tai-opt %s --tai-make-adjoint | FileCheck %s --check-prefix=TAPED
// RUN: tai-opt %s --tai-make-adjoint=kernel=unused | FileCheck %s --check-prefix=NAMED
// RUN: tai-opt %s --tai-autodiff | FileCheck %s --check-prefix=TAPED
// RUN: not tai-opt %s --tai-make-adjoint=kernel=missing 2>&1 | FileCheck %s --check-prefix=MISSING

// Without names, the kernels that run under a tape are differentiated, also
// those launched by a function called there. With names, these alone.

// TAPED-DAG: tai.kernel @direct() attributes {adjoint = @direct_grad{{.*}}}
// TAPED-DAG: tai.kernel @called() attributes {adjoint = @called_grad{{.*}}}
// TAPED-NOT: @unused_grad
// TAPED-NOT: @replaced_grad
// NAMED-NOT: @direct_grad
//     NAMED: tai.kernel @unused() attributes {adjoint = @unused_grad}
// NAMED-NOT: @called_grad
//   MISSING: error: there is no kernel or function '@missing' to differentiate

tai.tree @t : !tai.root<{loss: f32, loss_grad: f32}>
tai.field @loss_grad = @t["loss_grad"] : f32, rank 0
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @loss_grad
tai.kernel @direct() {
  tai.return
}
tai.kernel @called() {
  tai.return
}
tai.kernel @unused() {
  tai.return
}
// A kernel that has an adjoint keeps it, and an adjoint needs none.
tai.kernel @replaced() attributes {adjoint = @by_hand} {
  tai.return
}
tai.kernel @by_hand() {
  tai.return
}
func.func @step() {
  tai.launch @called() : () -> ()
  return
}
func.func private @elsewhere()
func.func @main() {
  tai.launch @unused() : () -> ()
  tai.tape loss(@loss) {
    tai.launch @direct() : () -> ()
    func.call @step() : () -> ()
    func.call @step() : () -> ()
    func.call @elsewhere() : () -> ()
    tai.launch @replaced() : () -> ()
  }
  return
}

// Kernels that only run forward may overwrite their inputs.
tai.field @x_grad = @s["x_grad"] : f32, rank 1
tai.field @x = @s["x"] : f32, rank 1, adjoint @x_grad
tai.tree @s : !tai.root<dense<[i: 4], {x: f32, x_grad: f32}>>
tai.kernel @in_place() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
