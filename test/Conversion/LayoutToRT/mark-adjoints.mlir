// RUN: tai-opt %s --tai-lower-layout | FileCheck %s
// RUN: tai-opt %s --tai-lower-layout=on-device | FileCheck %s --check-prefix=PLAIN
// RUN: tai-opt %s --tai-to-llvm | FileCheck %s --check-prefix=PLAIN

// Accesses to a field are marked if another field names it as its
// adjoint, whatever it is called and wherever it is placed; on the host alone.

tai.tree @t : !tai.root<dense<[i: 8], {x: f32, grad: f32, other: f32}>>
tai.field @x = @t["x"] : f32, rank 1, adjoint @slope
tai.field @slope = @t["grad"] : f32, rank 1
tai.field @x_grad = @t["other"] : f32, rank 1

// PLAIN-NOT: tai.adjoint_access

// CHECK-LABEL: tai.kernel @copies(
//       CHECK:   %[[X:.+]] = llvm.load
//   CHECK-NOT:   tai.adjoint_access
//       CHECK:   llvm.store %[[X]]
//   CHECK-NOT:   tai.adjoint_access
//       CHECK:   %[[SLOPE:.+]] = llvm.load {{.*}}tai.adjoint_access
//       CHECK:   llvm.store %[[SLOPE]]
//   CHECK-NOT:   tai.adjoint_access
//       CHECK:   llvm.atomicrmw fadd {{.*}}tai.adjoint_access
tai.kernel @copies(%i: index, %a: f32) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %0 = tai.load @x[%i] : f32
  tai.store %0, @x_grad[%i] : f32
  %1 = tai.load @slope[%i] : f32
  tai.store %1, @x[%i] : f32
  tai.parallel_for (%j) = (%c0) to (%c8) {
    tai.atomic add %a, @slope[%j] : f32
  }
  tai.return
}
