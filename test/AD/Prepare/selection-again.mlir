// RUN: tai-opt %s --tai-make-adjoint --tai-forward-diff | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint --tai-make-adjoint --tai-forward-diff --tai-forward-diff=kernel=f | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint=kernel=f --tai-make-adjoint=kernel=f,k,whole --tai-forward-diff | FileCheck %s

// What has an adjoint, or a tangent, keeps it: of its own, by name, as a part, as
// an adjoint, and in a nested module that was differentiated by itself.

// CHECK-COUNT-1: func.func @f_grad(
// CHECK-NOT: @f_grad_grad
tai.tree @t : !tai.root<{loss: f32, loss_grad: f32}>
tai.field @loss_grad = @t["loss_grad"] : f32, rank 0
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @loss_grad
func.func @f(%x: memref<f32>, %y: memref<f32>) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f32>
  memref.store %0, %y[] : memref<f32>
  return
}
// CHECK-NOT: @by_hand_grad
// CHECK-NOT: @k_grad
// CHECK: tai.kernel @k() attributes {adjoint = @by_hand
tai.kernel @k() attributes {adjoint = @by_hand} {
  tai.return
}
tai.kernel @by_hand() {
  tai.return
}
// CHECK: tai.kernel @whole()
// CHECK: tai.kernel @whole.0() attributes {adjoint = @whole.0_grad
// CHECK-NOT: @whole.1_grad
// CHECK: tai.kernel @whole.1() attributes {adjoint = @by_hand
tai.kernel @whole() {
  tai.return
}
tai.kernel @whole.0() attributes {part_of = @whole} {
  tai.return
}
tai.kernel @whole.1() attributes {adjoint = @by_hand, part_of = @whole} {
  tai.return
}
// CHECK: module @inner
module @inner {
  func.func private @g_grad(memref<f32>, memref<f32>)
  func.func @g(%x: memref<f32>) attributes {tai.differentiate, tai.adjoint = @g_grad} {
    return
  }
  func.func private @h_fwd(memref<f32>, memref<f32>)
  func.func @h(%x: memref<f32>) attributes {tai.differentiate, tai.tangent = @h_fwd} {
    return
  }
}
