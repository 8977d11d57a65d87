// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-autodiff | FileCheck %s

// The adjoint of f32 is f64: loads of it are rounded, additions are widened.
// Its kernel has the modes of the other.
tai.tree @s : !tai.root<dense<[i: 64], {x: f32, y: f32, gx: f64, gy: f64}>>
tai.field @x = @s["x"] : f32, rank 1, adjoint @gx
tai.field @y = @s["y"] : f32, rank 1, adjoint @gy
tai.field @gx = @s["gx"] : f64, rank 1
tai.field @gy = @s["gy"] : f64, rank 1

// CHECK-LABEL: tai.kernel @square_grad
//  CHECK-SAME:     modes = {math = "strict"}
//       CHECK:   %[[G:.+]] = tai.load @gy[%{{.+}}] : f64
//       CHECK:   %[[N:.+]] = arith.truncf %[[G]] : f64 to f32
//       CHECK:   arith.mulf {{.*}} : f32
//       CHECK:   %[[W:.+]] = arith.extf %{{.+}} : f32 to f64
//       CHECK:   tai.atomic add %[[W]], @gx{{.*}} : f64
tai.kernel @square() attributes {modes = {math = "strict"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// -----

// A value computed in f64 is added as such, and not by way of f32.
tai.tree @s : !tai.root<dense<[i: 64], {x: f32, y: f32, gx: f64, gy: f64}>>
tai.field @x = @s["x"] : f32, rank 1, adjoint @gx
tai.field @y = @s["y"] : f32, rank 1, adjoint @gy
tai.field @gx = @s["gx"] : f64, rank 1
tai.field @gy = @s["gy"] : f64, rank 1

// CHECK-LABEL: tai.kernel @square_grad
//       CHECK:   %[[G:.+]] = tai.load @gy[%{{.+}}] : f64
//       CHECK:   arith.mulf %[[G]], %{{.+}} : f64
//   CHECK-NOT:   arith.truncf
//       CHECK:   tai.atomic add %{{.+}}, @gx{{.*}} : f64
tai.kernel @square() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.extf %0 : f32 to f64
    %2 = arith.mulf %1, %1 : f64
    %3 = arith.truncf %2 : f64 to f32
    tai.store %3, @y[%i] : f32
  }
  tai.return
}

// -----

// Narrower than the field it may not be: it is a sum.
tai.tree @s : !tai.root<dense<[i: 64], {x: f64, gx: f32}>>
// expected-error @+1 {{expects adjoint '@gx' to have type 'f64' and rank 1}}
tai.field @x = @s["x"] : f64, rank 1, adjoint @gx
// expected-note @+1 {{it has type 'f32' and rank 1}}
tai.field @gx = @s["gx"] : f32, rank 1
