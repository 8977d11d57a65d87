// Kernels for graphs whose launches overlap: each lets the next one be made
// ready, and waits for the one before. They have begun when that one writes, so
// that no load goes past the caches of writes. Facts about addresses stay
// known.
//
// RUN: tai-translate --tai-to-ptx %s | FileCheck %s --check-prefix=PLAIN
// RUN: tai-translate --tai-to-ptx --device-overlapped %s | FileCheck %s
// RUN: not tai-translate --tai-to-ptx --device-overlapped --device-target=emulated %s 2>&1 | FileCheck %s --check-prefix=EMULATED

// EMULATED: the emulated device has no PTX

gpu.module @kernels {
  // PLAIN-LABEL: .entry add(
  // PLAIN-NOT: griddepcontrol
  // PLAIN: ld.global.nc
  // PLAIN: red.relaxed.gpu.global.add.v4.f32

  // CHECK-LABEL: .entry tai_overlapped0(
  // CHECK-NOT: .maxntid
  // CHECK-NOT: ld.global
  // CHECK: griddepcontrol.launch_dependents;
  // CHECK-NOT: ld.global
  // CHECK: griddepcontrol.wait;
  // CHECK-NOT: ld.global.nc
  // CHECK: ld.global.b32
  // CHECK-NOT: ld.global.nc
  // CHECK: red.relaxed.gpu.global.add.v4.f32
  llvm.func @add(%p: !llvm.ptr {llvm.align = 16 : i64, llvm.noalias}, %q: !llvm.ptr {llvm.align = 16 : i64, llvm.noalias, llvm.readonly}) attributes {gpu.kernel} {
    %i = nvvm.read.ptx.sreg.tid.x : i32
    %place = llvm.getelementptr inbounds %q[%i] : (!llvm.ptr, i32) -> !llvm.ptr, f32
    %a = llvm.load %place invariant : !llvm.ptr -> f32
    %0 = llvm.getelementptr inbounds %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<4 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.getelementptr inbounds %0[2] : (!llvm.ptr) -> !llvm.ptr, f32
    %3 = llvm.getelementptr inbounds %0[3] : (!llvm.ptr) -> !llvm.ptr, f32
    %4 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %5 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    %6 = llvm.atomicrmw fadd %2, %a monotonic : !llvm.ptr, f32
    %7 = llvm.atomicrmw fadd %3, %a monotonic : !llvm.ptr, f32
    llvm.return
  }

  // Large blocks leave each thread few registers: the assembler is told.
  // CHECK-LABEL: .entry tai_overlapped1(
  // CHECK: .maxntid 512
  // CHECK: griddepcontrol.wait;
  // CHECK: st.global
  llvm.func @store(%p: !llvm.ptr) attributes {gpu.kernel, passthrough = [["tai.block_size", "512"]]} {
    %zero = llvm.mlir.constant(0.0 : f32) : f32
    llvm.store %zero, %p : f32, !llvm.ptr
    llvm.return
  }
}
