// RUN: tai-opt %s --convert-tai-to-scf | FileCheck %s
// RUN: tai-opt %s --tai-to-llvm | FileCheck %s --check-prefix=LLVM

// A stack stands in the frame of the function, with its first slots.

// CHECK-LABEL: llvm.func @k
//       CHECK:   %[[STACK:.+]] = llvm.alloca {{.*}}!llvm.array<16 x i64>
//       CHECK:   %[[OWN:.+]] = llvm.getelementptr inbounds %[[STACK]][3]
//       CHECK:   llvm.store %[[OWN]], %[[STACK]]
//       CHECK:   scf.for
//       CHECK:     %[[FULL:.+]] = arith.cmpi eq
//       CHECK:     scf.if %[[FULL]] {
//       CHECK:       llvm.call @tai_rt_stack_grow(%{{.+}}, %[[STACK]])
//       CHECK:   scf.for
//       CHECK:     llvm.load %{{.+}} : !llvm.ptr -> f32
//       CHECK:   scf.if
//       CHECK:     llvm.call @tai_rt_stack_free(%[[STACK]])
//  LLVM-LABEL: llvm.func @k
//    LLVM-NOT: tai.stack
tai.kernel @k(%n: index) -> f32 {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %x = arith.constant 1.5 : f32
  %s = tai.stack_create : !tai.stack<f32>
  scf.for %i = %c0 to %n step %c1 {
    tai.stack_push %x, %s : f32
  }
  %sum = scf.for %i = %c0 to %n step %c1 iter_args(%v = %x) -> f32 {
    %p = tai.stack_pop %s : f32
    %w = arith.addf %v, %p : f32
    scf.yield %w : f32
  }
  tai.stack_destroy %s : !tai.stack<f32>
  tai.return %sum : f32
}
