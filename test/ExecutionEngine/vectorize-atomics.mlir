// Atomic additions to neighbours become one, where the memory can do that
// (sm_90) and a vector may lie there.
//
// RUN: tai-translate --tai-to-ptx %s | FileCheck %s
// RUN: tai-translate --tai-to-ptx --device-target=sm_80 %s | FileCheck %s --check-prefix=OLD

// OLD-NOT: red.

gpu.module @kernels {
  // CHECK-LABEL: .entry four(
  // CHECK: red.relaxed.gpu.global.add.v4.f32 [%rd{{[0-9]+}}], {[[A:%r[0-9]+]], [[B:%r[0-9]+]], [[A]], [[B]]};
  // CHECK-NOT: atom
  llvm.func @four(%p: !llvm.ptr {llvm.align = 16 : i64}, %a: f32, %b: f32) attributes {gpu.kernel} {
    %i = nvvm.read.ptx.sreg.tid.x : i32
    %0 = llvm.getelementptr inbounds %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<4 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.getelementptr inbounds %0[2] : (!llvm.ptr) -> !llvm.ptr, f32
    %3 = llvm.getelementptr inbounds %0[3] : (!llvm.ptr) -> !llvm.ptr, f32
    // In any order.
    %4 = llvm.atomicrmw fadd %2, %a monotonic : !llvm.ptr, f32
    %5 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %6 = llvm.atomicrmw fadd %3, %b monotonic : !llvm.ptr, f32
    %7 = llvm.atomicrmw fadd %1, %b monotonic : !llvm.ptr, f32
    llvm.return
  }

  // A record of three: two and one.
  // CHECK-LABEL: .entry three(
  // CHECK-DAG: red.relaxed.gpu.global.add.v2.f32 [%rd{{[0-9]+}}], {{{%r[0-9]+, %r[0-9]+}}};
  // CHECK-DAG: atom.global.add.f32 {{.+}}+8], %r
  // CHECK: ret
  llvm.func @three(%p: !llvm.ptr {llvm.align = 16 : i64}, %a: f32) attributes {gpu.kernel} {
    %i = nvvm.read.ptx.sreg.tid.x : i32
    %0 = llvm.getelementptr inbounds %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<4 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.getelementptr inbounds %0[2] : (!llvm.ptr) -> !llvm.ptr, f32
    %3 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %4 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    %5 = llvm.atomicrmw fadd %2, %a monotonic : !llvm.ptr, f32
    llvm.return
  }

  // Records of three without a gap lie anywhere.
  // CHECK-LABEL: .entry packed(
  // CHECK-NOT: red.
  // CHECK-COUNT-3: atom.global.add.f32
  llvm.func @packed(%p: !llvm.ptr {llvm.align = 16 : i64}, %a: f32) attributes {gpu.kernel} {
    %i = nvvm.read.ptx.sreg.tid.x : i32
    %0 = llvm.getelementptr inbounds %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<3 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.getelementptr inbounds %0[2] : (!llvm.ptr) -> !llvm.ptr, f32
    %3 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %4 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    %5 = llvm.atomicrmw fadd %2, %a monotonic : !llvm.ptr, f32
    llvm.return
  }

  // A read of the former value, or of the memory in between, sees the program's
  // order.
  // CHECK-LABEL: .entry seen(
  // CHECK: atom.global.add.f32
  // CHECK: ld.global.b32
  // CHECK: atom.global.add.f32
  // CHECK: st.global.b32
  // CHECK-NOT: red.
  llvm.func @seen(%p: !llvm.ptr {llvm.align = 16 : i64}, %q: !llvm.ptr, %a: f32) attributes {gpu.kernel} {
    %i = nvvm.read.ptx.sreg.tid.x : i32
    %0 = llvm.getelementptr inbounds %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<4 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.getelementptr inbounds %0[2] : (!llvm.ptr) -> !llvm.ptr, f32
    %3 = llvm.getelementptr inbounds %0[3] : (!llvm.ptr) -> !llvm.ptr, f32
    %4 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %5 = llvm.load %q : !llvm.ptr -> f32
    %6 = llvm.atomicrmw fadd %1, %5 monotonic : !llvm.ptr, f32
    llvm.store %a, %q : f32, !llvm.ptr
    %7 = llvm.atomicrmw fadd %2, %a monotonic : !llvm.ptr, f32
    %8 = llvm.atomicrmw fadd %3, %a monotonic : !llvm.ptr, f32
    llvm.store %8, %q : f32, !llvm.ptr
    llvm.return
  }

  // CHECK-LABEL: .entry barrier(
  // CHECK: atom.global.add.f32
  // CHECK: bar.sync
  // CHECK: atom.global.add.f32
  llvm.func @barrier(%p: !llvm.ptr {llvm.align = 16 : i64}, %a: f32) attributes {gpu.kernel} {
    %1 = llvm.getelementptr inbounds %p[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.atomicrmw fadd %p, %a monotonic : !llvm.ptr, f32
    nvvm.barrier0
    %3 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    llvm.return
  }
}
