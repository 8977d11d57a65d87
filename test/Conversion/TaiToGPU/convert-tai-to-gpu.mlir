// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics=on-device --tai-lower-layout --convert-tai-to-gpu | FileCheck %s
// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics=on-device --tai-lower-layout --convert-tai-to-gpu --tai-lower-launches | FileCheck %s --check-prefix=CALLS

tai.tree @t : !tai.root<dense<[i: 128, j: 64], {x: f32, y: f32}>, {sum: f32, n: i32}>
tai.field @x = @t["x"] : f32, rank 2
tai.field @y = @t["y"] : f32, rank 2
tai.field @sum = @t["sum"] : f32, rank 0
tai.field @n = @t["n"] : i32, rank 0

// A loop becomes a function of its operands, and a launch.
// CHECK-LABEL: gpu.module @kernels
//   How a tree is aligned is known, and that two fields are neighbours in it.
//       CHECK:   llvm.func @scale_0(%[[TREE:[^:]+]]: !llvm.ptr {llvm.align = 16 : i64}, %[[S:[^:]+]]: f32)
//  CHECK-SAME:       attributes {gpu.kernel
//       CHECK:     llvm.getelementptr inbounds|nuw %[[TREE]][4]
//       CHECK:     %[[COUNT:.+]] = arith.constant 8192 : index
//       CHECK:     gpu.block_id
//       CHECK:     gpu.thread_id
//       CHECK:     scf.for %{{.+}} = %{{.+}} to %[[COUNT]] step
//       CHECK:       llvm.load {{.+}} invariant
//       CHECK:       arith.mulf %{{.+}}, %[[S]]
//       CHECK:       llvm.store

// The sum of a block goes to memory at once.
// CHECK-LABEL: llvm.func @total_0(
//       CHECK:     scf.for
//   CHECK-NOT:       llvm.atomicrmw
//       CHECK:     llvm.call @tai_dev_reduce_add_f32

// Serial code that touches fields is one thread's; what later loops use goes
// through device memory.
// CHECK-LABEL: llvm.func @serial_0(
//       CHECK:     scf.for %{{.+}} = %{{.+}} to %c1
//       CHECK:       %[[SUM:.+]] = llvm.load
//       CHECK:       llvm.store %[[SUM]], %{{.+}} : f32, !llvm.ptr
// CHECK-LABEL: llvm.func @serial_1(
//       CHECK:     %[[AGAIN:.+]] = llvm.load %{{.+}} : !llvm.ptr -> f32
//       CHECK:     scf.for
//       CHECK:       llvm.store %[[AGAIN]]

// The device alone knows how long this loop is.
// CHECK-LABEL: llvm.func @bounded_1(
//       CHECK:     %[[SLOT:.+]] = llvm.load %{{.+}} : !llvm.ptr -> i64
//       CHECK:     %[[N:.+]] = arith.index_cast %[[SLOT]]
//       CHECK:     scf.for %{{.+}} = %{{.+}} to %{{.+}} step

// Loops around loops stay with the host.
// CHECK-LABEL: llvm.func @scale(
//       CHECK:   gpu.launch_func @kernels::@scale_0 blocks in (%c32{{.*}}) threads in (%c256
tai.kernel @scale(%s: f32) {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    %1 = arith.mulf %0, %s : f32
    tai.store %1, @y[%i, %j] : f32
  }
  tai.return
}

tai.kernel @total() {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    %1 = tai.atomic add %0, @sum[] : f32
  }
  tai.return
}

tai.kernel @serial() {
  %0 = tai.load @sum[] : f32
  tai.parallel_for (%i, %j) in @x {
    tai.store %0, @x[%i, %j] : f32
  }
  tai.return
}

// CHECK-LABEL: llvm.func @bounded(
//       CHECK:   %[[ZERO:.+]] = arith.constant 0 : index
//       CHECK:   gpu.launch_func @kernels::@bounded_1 blocks in (%[[ZERO]]
tai.kernel @bounded() {
  %c0 = arith.constant 0 : index
  %n = tai.load @n[] : i32
  %upper = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%c0) to (%upper) {
    %z = arith.constant 0.0 : f32
    tai.store %z, @x[%i, %c0] : f32
  }
  tai.return
}

// CHECK-LABEL: llvm.func @steps(
//       CHECK:   scf.for
//       CHECK:     gpu.launch_func @kernels::@steps_0
//       CALLS: llvm.func @steps(%[[FRAME:.+]]: !llvm.ptr) -> i32
//       CALLS:   scf.for
//       CALLS:     llvm.call @tai_rt_device_launch(%[[FRAME]],
tai.kernel @steps(%n: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %upper = arith.index_cast %n : i32 to index
  scf.for %k = %c0 to %upper step %c1 {
    tai.parallel_for (%i, %j) in @x {
      %0 = tai.load @x[%i, %j] : f32
      tai.store %0, @y[%i, %j] : f32
    }
  }
  tai.return
}

// The caller's results wait for the device.
// CHECK-LABEL: llvm.func @result(
//       CHECK:   gpu.launch_func
//       CHECK:   llvm.call @tai_rt_device_fetch
//       CHECK:   llvm.store
tai.kernel @result() -> f32 {
  %0 = tai.load @sum[] : f32
  tai.return %0 : f32
}

// An array that nobody looks at is not brought to the device: there may be no
// device code.
// CHECK-LABEL: llvm.func @unused(
//   CHECK-NOT:   tai_rt_device_array
//       CHECK:   llvm.return
tai.kernel @unused(%a: memref<?xf32>) {
  tai.return
}

// An array of the caller is brought to the device, and back if it is written.
// CHECK-LABEL: llvm.func @arrays(
//       CHECK:   %[[NO:.+]] = arith.constant 0 : i32
//       CHECK:   llvm.call @tai_rt_device_array(%{{.+}}, %{{.+}}, %{{.+}}, %[[NO]])
//       CHECK:   llvm.call @tai_rt_device_array
tai.kernel @arrays(%a: memref<?xf32>, %b: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %n = memref.dim %a, %c0 : memref<?xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = memref.load %a[%i] : memref<?xf32>
    memref.store %0, %b[%i] : memref<?xf32>
  }
  tai.return
}
