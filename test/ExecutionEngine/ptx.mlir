// From a gpu.module to PTX: elements read once go past the cache that writes
// use, and float operations say how they are rounded.
//
// RUN: tai-translate --tai-to-ptx %s | FileCheck %s --check-prefixes=CHECK,DEFAULT
// RUN: tai-translate --tai-to-ptx --device-floats=strict %s | FileCheck %s --check-prefixes=CHECK,STRICT
// RUN: tai-translate --tai-to-ptx --device-floats=fast %s | FileCheck %s --check-prefixes=CHECK,FAST

module attributes {gpu.container_module} {
  // Code of the host is not looked at.
  llvm.func @host(%frame: !llvm.ptr) -> i32 {
    %zero = llvm.mlir.constant(0 : i32) : i32
    llvm.return %zero : i32
  }

  gpu.module @kernels {
    // CHECK-LABEL: .visible .entry saxpy
    // CHECK: ld.global.nc.b32
    // STRICT: mul.rn.f32
    // STRICT-NEXT: add.rn.f32
    // STRICT-NEXT: div.rn.f32
    // STRICT-NEXT: sqrt.rn.f32
    // DEFAULT: fma.rn.f32
    // DEFAULT-NEXT: div.rn.f32
    // DEFAULT-NEXT: sqrt.rn.f32
    // FAST: fma.rn.f32
    // FAST-NEXT: div.approx.f32
    // FAST-NEXT: sqrt.approx.f32
    // CHECK: st.global.b32
    llvm.func @saxpy(%x: !llvm.ptr, %y: !llvm.ptr, %a: f32, %n: i32) attributes {gpu.kernel, nvvm.kernel} {
      %thread = nvvm.read.ptx.sreg.tid.x : i32
      %block = nvvm.read.ptx.sreg.ctaid.x : i32
      %threads = nvvm.read.ptx.sreg.ntid.x : i32
      %first = llvm.mul %block, %threads : i32
      %i = llvm.add %first, %thread : i32
      %inside = llvm.icmp "slt" %i, %n : i32
      llvm.cond_br %inside, ^body, ^done
    ^body:
      %xi = llvm.getelementptr inbounds %x[%i] : (!llvm.ptr, i32) -> !llvm.ptr, f32
      %yi = llvm.getelementptr inbounds %y[%i] : (!llvm.ptr, i32) -> !llvm.ptr, f32
      %vx = llvm.load %xi invariant : !llvm.ptr -> f32
      %vy = llvm.load %yi : !llvm.ptr -> f32
      %product = llvm.fmul %vx, %a : f32
      %sum = llvm.fadd %product, %vy : f32
      %quotient = llvm.fdiv %sum, %a : f32
      %root = llvm.intr.sqrt(%quotient) : (f32) -> f32
      llvm.store %root, %yi : f32, !llvm.ptr
      llvm.br ^done
    ^done:
      llvm.return
    }

    // A function that no kernel calls is not there, and one that is called is
    // not a symbol that another module could see.
    // CHECK-NOT: unused
    llvm.func @unused(%x: f32) -> f32 {
      llvm.return %x : f32
    }

    // Neighbours in memory are read and written at once.
    // CHECK-LABEL: .visible .entry vectors
    // CHECK: ld.global.nc.v4.b32
    // CHECK: st.global.v4.b32
    llvm.func @vectors(%x: !llvm.ptr {llvm.noalias}, %y: !llvm.ptr {llvm.noalias}) attributes {gpu.kernel} {
      %thread = nvvm.read.ptx.sreg.tid.x : i32
      %xi = llvm.getelementptr inbounds %x[%thread] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<4 x f32>
      %yi = llvm.getelementptr inbounds %y[%thread] : (!llvm.ptr, i32) -> !llvm.ptr, !llvm.array<4 x f32>
      %x1 = llvm.getelementptr inbounds %xi[1] : (!llvm.ptr) -> !llvm.ptr, f32
      %x2 = llvm.getelementptr inbounds %xi[2] : (!llvm.ptr) -> !llvm.ptr, f32
      %x3 = llvm.getelementptr inbounds %xi[3] : (!llvm.ptr) -> !llvm.ptr, f32
      %y1 = llvm.getelementptr inbounds %yi[1] : (!llvm.ptr) -> !llvm.ptr, f32
      %y2 = llvm.getelementptr inbounds %yi[2] : (!llvm.ptr) -> !llvm.ptr, f32
      %y3 = llvm.getelementptr inbounds %yi[3] : (!llvm.ptr) -> !llvm.ptr, f32
      %a = llvm.load %xi invariant {alignment = 16 : i64} : !llvm.ptr -> f32
      %b = llvm.load %x1 invariant : !llvm.ptr -> f32
      %c = llvm.load %x2 invariant : !llvm.ptr -> f32
      %d = llvm.load %x3 invariant : !llvm.ptr -> f32
      llvm.store %d, %yi {alignment = 16 : i64} : f32, !llvm.ptr
      llvm.store %c, %y1 : f32, !llvm.ptr
      llvm.store %b, %y2 : f32, !llvm.ptr
      llvm.store %a, %y3 : f32, !llvm.ptr
      llvm.return
    }

    // Atomic operations are those of the device, not of the whole system.
    // CHECK-LABEL: .visible .entry atomics
    // CHECK: atom.global.add.f32
    // CHECK: atom.relaxed.gpu.global.cas.b32
    // CHECK-NOT: .sys.
    llvm.func @atomics(%target: !llvm.ptr, %x: f32, %i: i32) attributes {nvvm.kernel} {
      %old = llvm.atomicrmw fadd %target, %x monotonic : !llvm.ptr, f32
      %seen = llvm.cmpxchg %target, %i, %i monotonic monotonic : !llvm.ptr, i32
      llvm.return
    }
  }
}
