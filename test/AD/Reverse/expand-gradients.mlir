// RUN: tai-opt %s --tai-expand-gradients --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-expand-gradients --inline --canonicalize --split-input-file -o /dev/null

// The derivative by the first argument: the second one is constant, and has no gradient.
// CHECK-LABEL: func.func @force(
//  CHECK-SAME:     %[[X:.+]]: f64, %[[K:.+]]: f64) -> f64
//       CHECK:   %[[SEED:.+]] = memref.alloca() : memref<f64>
//       CHECK:   %[[GRADIENT:.+]] = memref.alloca() : memref<f64>
//   CHECK-DAG:   %[[MINUS:.+]] = arith.constant -1.0
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.0
//       CHECK:   memref.store %[[ZERO]], %[[GRADIENT]][]
//       CHECK:   memref.store %[[MINUS]], %[[SEED]][]
//       CHECK:   call @energy_by_0_of_0_grad(%[[X]], %[[K]], %[[GRADIENT]], %[[SEED]])
//       CHECK:   %[[RESULT:.+]] = memref.load %[[GRADIENT]][]
//       CHECK:   return %[[RESULT]]
// The function is as it was, and the copy that was differentiated is gone.
//       CHECK: func.func @energy(%{{.+}}: f64, %{{.+}}: f64) -> f64 {
//   CHECK-NOT: func.func {{.*}}@energy_by_0_of_0(
//       CHECK: func.func private @energy_by_0_of_0_grad(
//   CHECK-NOT: func.func {{.*}}@energy_by_0_of_0(
func.func @force(%x: f64, %k: f64) -> f64 {
  %minus = arith.constant -1.0 : f64
  %f = tai.grad @energy(%x, %k, %minus) wrt [0] : (f64, f64, f64) -> f64
  return %f : f64
}
func.func @energy(%x: f64, %k: f64) -> f64 {
  %q = arith.mulf %x, %x : f64
  %e = arith.mulf %k, %q : f64
  return %e : f64
}

// -----

// All floats are active: an array has its gradient among the operands, and a vector its
// own components. One derivative serves both.
// CHECK-LABEL: func.func @twice(
//  CHECK-SAME:     %[[M:.+]]: memref<?xf32>, %[[G:.+]]: memref<?xf32>
//   CHECK-DAG:   memref.alloca() : memref<2xf32>
//       CHECK:   call @mix_by_0_1_of_0_grad(%[[M]], %{{.+}}, %{{.+}}, %[[G]], %[[V:.+]], %{{.+}})
//       CHECK:   memref.load %[[V]]
//       CHECK:   memref.load %[[V]]
//       CHECK:   vector.from_elements
//       CHECK:   call @mix_by_0_1_of_0_grad(
//       CHECK: func.func private @mix_by_0_1_of_0_grad(
//   CHECK-NOT: func.func private @mix
func.func @twice(%m: memref<?xf32>, %g: memref<?xf32>, %v: vector<2xf32>, %n: index, %s: f32)
    -> (vector<2xf32>, vector<2xf32>) {
  %0 = tai.grad @mix(%m, %v, %n, %g, %s)
      : (memref<?xf32>, vector<2xf32>, index, memref<?xf32>, f32) -> vector<2xf32>
  %1 = tai.grad @mix(%m, %v, %n, %g, %s) wrt [0, 1] of [0]
      : (memref<?xf32>, vector<2xf32>, index, memref<?xf32>, f32) -> vector<2xf32>
  return %0, %1 : vector<2xf32>, vector<2xf32>
}
func.func private @mix(%m: memref<?xf32>, %v: vector<2xf32>, %n: index) -> f32 {
  %a = memref.load %m[%n] : memref<?xf32>
  %b = vector.extract %v[0] : f32 from vector<2xf32>
  %c = vector.extract %v[1] : f32 from vector<2xf32>
  %d = arith.mulf %a, %b : f32
  %e = arith.mulf %d, %c : f32
  return %e : f32
}

// -----

// A rule of the function's own, by the same positions.
// CHECK-LABEL: func.func @user(
//       CHECK:   call @cube_rule(
//   CHECK-NOT: func.func {{.*}}_by_
func.func @user(%x: f64) -> f64 {
  %one = arith.constant 1.0 : f64
  %0 = tai.grad @cube(%x, %one) : (f64, f64) -> f64
  return %0 : f64
}
func.func @cube(%x: f64) -> f64
    attributes {tai.adjoint = @cube_rule, tai.differentiate, tai.gradients = array<i64: 0, 1>} {
  %q = arith.mulf %x, %x : f64
  %r = arith.mulf %q, %x : f64
  return %r : f64
}
func.func @cube_rule(%x: f64, %gx: memref<f64>, %s: memref<f64>) {
  %c = arith.constant 3.0 : f64
  %q = arith.mulf %x, %x : f64
  %d = arith.mulf %c, %q : f64
  %seed = memref.load %s[] : memref<f64>
  %p = arith.mulf %d, %seed : f64
  %old = memref.load %gx[] : memref<f64>
  %new = arith.addf %old, %p : f64
  memref.store %new, %gx[] : memref<f64>
  return
}

// -----

// Nothing to do: the module stays.
// CHECK-LABEL: func.func @plain(
//  CHECK-NEXT:   return
func.func @plain() attributes {tai.differentiate} {
  return
}

// -----

// Iterations that may run side by side have memory of their own; those of a serial loop
// share it.
// CHECK-LABEL: tai.kernel @loop(
//       CHECK:   tai.parallel_for
//  CHECK-NEXT:     memref.alloca() : memref<f32>
//  CHECK-NEXT:     memref.alloca() : memref<f32>
//       CHECK:     scf.for
//   CHECK-NOT:       memref.alloca
//       CHECK:       call @twice_by_0_of_0_grad
func.func private @twice(%x: f32) -> f32 {
  %0 = arith.addf %x, %x : f32
  return %0 : f32
}
tai.kernel @loop(%x: f32, %m: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%c8) {
    scf.for %j = %c0 to %c8 step %c1 {
      %0 = tai.grad @twice(%x, %x) : (f32, f32) -> f32
      memref.store %0, %m[%i] : memref<?xf32>
    }
  }
  tai.return
}
