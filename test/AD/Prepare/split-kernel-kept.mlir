// RUN: tai-opt %s --tai-split-kernel | FileCheck %s
// RUN: tai-opt %s --tai-split-kernel --tai-split-kernel | FileCheck %s

// A kernel that has no gradient for another reason is left to the error at its
// place, and so is one whose gradients name no numbers. Neither is split, nor is
// a part, and no trial is left over.

// CHECK-NOT: .0
// CHECK-NOT: trial

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32}>, dense<[i: 4], {a: f32, a_grad: f32}>>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @a = @t["a"] : f32, rank 1, adjoint @a_grad
tai.kernel @other_reason() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.bitcast %0 : f32 to i32
    %2 = arith.bitcast %1 : i32 to f32
    tai.store %2, @y[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @y[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
tai.kernel @wrong_gradients(%k: i32) attributes {gradients = array<i64: 0>} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
tai.kernel @part() attributes {part_of = @other_reason} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.exp %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
