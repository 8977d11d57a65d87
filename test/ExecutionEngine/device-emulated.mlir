// The emulated device calls kernels by the address of their parameters, which
// begin at multiples of eight bytes, each in its own type; a truth value is a
// byte. The kernel itself is part of that function.
//
// RUN: tai-translate --tai-to-device-llvmir --device-target=emulated %s | FileCheck %s

// CHECK: target triple = "{{.*}}linux
// CHECK: define void @set.slots(ptr {{.*}}%[[SLOTS:[0-9]+]])
// CHECK-DAG: %[[P:.*]] = load ptr, ptr %[[SLOTS]], align 8
// CHECK-DAG: %[[AT1:.*]] = getelementptr {{.*}}i8, ptr %[[SLOTS]], i64 8
// CHECK-DAG: load i8, ptr %[[AT1]], align 8
// CHECK-DAG: %[[AT2:.*]] = getelementptr {{.*}}i8, ptr %[[SLOTS]], i64 16
// CHECK-DAG: %[[X:.*]] = load float, ptr %[[AT2]], align 8
// CHECK: call i32 @tai_emu_thread_id()
// CHECK: store float {{.*}}, ptr
// CHECK-NOT: define {{.*}}@set(
gpu.module @kernels {
  llvm.func @tai_dev_thread_id() -> i32
  llvm.func @set(%p: !llvm.ptr, %on: i1, %x: f32) attributes {gpu.kernel} {
    %thread = llvm.call @tai_dev_thread_id() : () -> i32
    %at = llvm.getelementptr %p[%thread] : (!llvm.ptr, i32) -> !llvm.ptr, f32
    %zero = llvm.mlir.constant(0.0 : f32) : f32
    %value = llvm.select %on, %x, %zero : i1, f32
    llvm.store %value, %at : f32, !llvm.ptr
    llvm.return
  }
}
