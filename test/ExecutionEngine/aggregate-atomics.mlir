// Additions of all threads of a warp to the same elements are added up first;
// and loads come before stores to other memory.
//
// RUN: tai-translate --tai-to-ptx %s | FileCheck %s
// RUN: tai-translate --tai-to-ptx --device-target=sm_80 %s | FileCheck %s

gpu.module @kernels {
  // Two elements for all: five exchanges, and one addition by each of two
  // threads. Some of the first threads alone, and any others, are ways of their
  // own.
  // CHECK-LABEL: .entry shared(
  // CHECK-NOT: match
  // CHECK: activemask.b32
  // CHECK-NOT: match
  // CHECK-COUNT-5: shfl.sync.bfly.b32
  // CHECK-NOT: shfl.sync.bfly.b32
  // CHECK-COUNT-10: shfl.sync.down.b32
  // CHECK-NOT: shfl.
  // CHECK: .entry
  llvm.func @shared(%p: !llvm.ptr, %q: !llvm.ptr) attributes {gpu.kernel} {
    %i = nvvm.read.ptx.sreg.tid.x : i32
    %0 = llvm.getelementptr inbounds %q[%i] : (!llvm.ptr, i32) -> !llvm.ptr, f32
    %a = llvm.load %0 : !llvm.ptr -> f32
    %b = llvm.fmul %a, %a : f32
    %1 = llvm.getelementptr inbounds %p[3] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.atomicrmw fadd %p, %a monotonic : !llvm.ptr, f32
    %3 = llvm.atomicrmw fadd %1, %b monotonic : !llvm.ptr, f32
    llvm.return
  }

  // Iterations that fill warps: each warp has one row, whose number is that of
  // the iteration without its last digits.
  // CHECK-LABEL: rows(
  // CHECK: activemask.b32
  // CHECK: match.all.sync.b64
  // CHECK-COUNT-5: shfl.sync.bfly.b32
  // CHECK: .entry
  llvm.func @rows(%p: !llvm.ptr, %a: f32) attributes {gpu.kernel} {
    %c6 = llvm.mlir.constant(6 : i32) : i32
    %count = llvm.mlir.constant(4096 : i32) : i32
    %thread = nvvm.read.ptx.sreg.tid.x : i32
    %threads = nvvm.read.ptx.sreg.ntid.x : i32
    %block = nvvm.read.ptx.sreg.ctaid.x : i32
    %blocks = nvvm.read.ptx.sreg.nctaid.x : i32
    %before = llvm.mul %block, %threads : i32
    %first = llvm.add %before, %thread : i32
    %all = llvm.mul %blocks, %threads : i32
    llvm.br ^loop(%first : i32)
  ^loop(%at: i32):
    %row = llvm.lshr %at, %c6 : i32
    %0 = llvm.getelementptr inbounds %p[%row] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<2 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %3 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    %next = llvm.add %at, %all : i32
    %more = llvm.icmp "ult" %next, %count : i32
    llvm.cond_br %more, ^loop(%next : i32), ^end
  ^end:
    llvm.return
  }

  // In each round all threads add to one element, but those that are here
  // together need not be in the same round: they compare.
  // CHECK-LABEL: rounds(
  // CHECK: activemask.b32
  // CHECK: match.all.sync.b64
  // CHECK-COUNT-5: shfl.sync.bfly.b32
  // CHECK: .entry
  llvm.func @rounds(%p: !llvm.ptr, %q: !llvm.ptr, %n: i32) attributes {gpu.kernel} {
    %zero = llvm.mlir.constant(0 : i32) : i32
    %one = llvm.mlir.constant(1 : i32) : i32
    %thread = nvvm.read.ptx.sreg.tid.x : i32
    %0 = llvm.getelementptr inbounds %q[%thread] : (!llvm.ptr, i32) -> !llvm.ptr, f32
    llvm.br ^loop(%zero : i32)
  ^loop(%j: i32):
    %a = llvm.load volatile %0 : !llvm.ptr -> f32
    %to = llvm.getelementptr inbounds %p[%j] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<2 x f32>
    %1 = llvm.getelementptr inbounds %to[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.atomicrmw fadd %to, %a monotonic : !llvm.ptr, f32
    %3 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    %next = llvm.add %j, %one : i32
    %more = llvm.icmp "slt" %next, %n : i32
    llvm.cond_br %more, ^loop(%next : i32), ^end
  ^end:
    llvm.return
  }

  // Two rows in each warp.
  // CHECK-LABEL: half_warps(
  // CHECK-NOT: activemask
  // CHECK: .entry
  llvm.func @half_warps(%p: !llvm.ptr, %a: f32) attributes {gpu.kernel} {
    %c6 = llvm.mlir.constant(4 : i32) : i32
    %count = llvm.mlir.constant(4096 : i32) : i32
    %thread = nvvm.read.ptx.sreg.tid.x : i32
    %threads = nvvm.read.ptx.sreg.ntid.x : i32
    %block = nvvm.read.ptx.sreg.ctaid.x : i32
    %blocks = nvvm.read.ptx.sreg.nctaid.x : i32
    %before = llvm.mul %block, %threads : i32
    %first = llvm.add %before, %thread : i32
    %all = llvm.mul %blocks, %threads : i32
    llvm.br ^loop(%first : i32)
  ^loop(%at: i32):
    %row = llvm.lshr %at, %c6 : i32
    %0 = llvm.getelementptr inbounds %p[%row] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<2 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %3 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    %next = llvm.add %at, %all : i32
    %more = llvm.icmp "ult" %next, %count : i32
    llvm.cond_br %more, ^loop(%next : i32), ^end
  ^end:
    llvm.return
  }

  // Iterations of a warp start anywhere after a step.
  // CHECK-LABEL: odd_steps(
  // CHECK-NOT: activemask
  // CHECK: .entry
  llvm.func @odd_steps(%p: !llvm.ptr, %a: f32) attributes {gpu.kernel} {
    %c6 = llvm.mlir.constant(6 : i32) : i32
    %count = llvm.mlir.constant(4096 : i32) : i32
    %thread = nvvm.read.ptx.sreg.tid.x : i32
    %threads = nvvm.read.ptx.sreg.ntid.x : i32
    %block = nvvm.read.ptx.sreg.ctaid.x : i32
    %blocks = nvvm.read.ptx.sreg.nctaid.x : i32
    %before = llvm.mul %block, %threads : i32
    %first = llvm.add %before, %thread : i32
    %all = llvm.add %blocks, %threads : i32
    llvm.br ^loop(%first : i32)
  ^loop(%at: i32):
    %row = llvm.lshr %at, %c6 : i32
    %0 = llvm.getelementptr inbounds %p[%row] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<2 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %3 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    %next = llvm.add %at, %all : i32
    %more = llvm.icmp "ult" %next, %count : i32
    llvm.cond_br %more, ^loop(%next : i32), ^end
  ^end:
    llvm.return
  }

  // Each thread has elements of its own.
  // CHECK-LABEL: own(
  // CHECK-NOT: activemask
  // CHECK: .entry
  llvm.func @own(%p: !llvm.ptr, %a: f32) attributes {gpu.kernel} {
    %i = nvvm.read.ptx.sreg.tid.x : i32
    %0 = llvm.getelementptr inbounds %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<2 x f32>
    %1 = llvm.getelementptr inbounds %0[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.atomicrmw fadd %0, %a monotonic : !llvm.ptr, f32
    %3 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    llvm.return
  }

  // A load in between sees the earlier additions.
  // CHECK-LABEL: between(
  // CHECK-NOT: activemask
  // CHECK: .entry
  llvm.func @between(%p: !llvm.ptr, %q: !llvm.ptr, %a: f32) attributes {gpu.kernel} {
    %1 = llvm.getelementptr inbounds %p[1] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.atomicrmw fadd %p, %a monotonic : !llvm.ptr, f32
    %3 = llvm.load %p : !llvm.ptr -> f32
    llvm.store %3, %q : f32, !llvm.ptr
    %4 = llvm.atomicrmw fadd %1, %a monotonic : !llvm.ptr, f32
    llvm.return
  }

  // Two elements, added to one after the other: both are loaded first.
  // CHECK-LABEL: elements(
  // CHECK: ld.global
  // CHECK-NEXT: ld.global
  // CHECK-NOT: ld.global
  // CHECK-COUNT-2: st.global
  // CHECK: ret
  llvm.func @elements(%p: !llvm.ptr, %a: f32) attributes {gpu.kernel} {
    %i = nvvm.read.ptx.sreg.tid.x : i32
    %0 = llvm.getelementptr inbounds %p[%i] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<9 x f32>
    %1 = llvm.getelementptr inbounds %0[7] : (!llvm.ptr) -> !llvm.ptr, f32
    %2 = llvm.load %0 : !llvm.ptr -> f32
    %3 = llvm.fadd %2, %a : f32
    llvm.store %3, %0 : f32, !llvm.ptr
    %4 = llvm.load %1 : !llvm.ptr -> f32
    %5 = llvm.fadd %4, %a : f32
    llvm.store %5, %1 : f32, !llvm.ptr
    llvm.return
  }
}
