// Loops of one thread that may be long ask whether they go on, as a GPU does
// not stop a kernel that runs; others do not, and such a kernel is not given
// the state of the device.
//
// RUN: tai-opt %s --tai-lower-layout --convert-tai-to-gpu --split-input-file | FileCheck %s

// It is known that this one is short.
// CHECK-LABEL: llvm.func @short_0(
//   CHECK-NOT:   tai_rt_go_on
tai.kernel @short(%x: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c1000 = arith.constant 1000 : index
  %n = memref.dim %x, %c0 : memref<?xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    scf.for %j = %c0 to %c1000 step %c1 {
      %0 = memref.load %x[%i] : memref<?xf32>
      %1 = arith.mulf %0, %0 : f32
      memref.store %1, %x[%i] : memref<?xf32>
    }
  }
  tai.return
}

// -----

// A short body, so many times: it asks now and then.
// CHECK-LABEL: llvm.func @long_0(
//  CHECK-SAME:   %[[STATE:[^:]+]]: !llvm.ptr
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:       %[[EVERY:.+]] = arith.constant 256 : i32
//       CHECK:       llvm.call @tai_rt_go_on(%[[STATE]], %[[EVERY]])
tai.kernel @long(%x: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %many = arith.constant 1000000000 : index
  %n = memref.dim %x, %c0 : memref<?xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    scf.for %j = %c0 to %many step %c1 {
      %0 = memref.load %x[%i] : memref<?xf32>
      %1 = arith.mulf %0, %0 : f32
      memref.store %1, %x[%i] : memref<?xf32>
    }
  }
  tai.return
}

// -----

// The neighbours of a particle do not ask, and the few loops over them neither.
// CHECK-LABEL: llvm.func @neighbours_0(
//   CHECK-NOT:   tai_rt_go_on
tai.kernel @neighbours(%x: memref<?xf32>, %count: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %n = memref.dim %x, %c0 : memref<?xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    scf.for %k = %c0 to %c3 step %c1 {
      scf.for %j = %c0 to %count step %c1 {
        %0 = memref.load %x[%i] : memref<?xf32>
        %1 = arith.mulf %0, %0 : f32
        memref.store %1, %x[%i] : memref<?xf32>
      }
    }
  }
  tai.return
}

// -----

// One loop of unknown length in another one: the outer one asks.
// CHECK-LABEL: llvm.func @nested_0(
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:       llvm.call @tai_rt_go_on
//       CHECK:       scf.for
//   CHECK-NOT:         tai_rt_go_on
//       CHECK:   llvm.return
tai.kernel @nested(%x: memref<?xf32>, %count: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = memref.dim %x, %c0 : memref<?xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    scf.for %k = %c0 to %count step %c1 {
      scf.for %j = %c0 to %count step %c1 {
        %0 = memref.load %x[%i] : memref<?xf32>
        %1 = arith.mulf %0, %0 : f32
        memref.store %1, %x[%i] : memref<?xf32>
      }
    }
  }
  tai.return
}

// -----

// The end of this one is unknown.
// CHECK-LABEL: llvm.func @search_0(
//       CHECK:   scf.while
//  CHECK-NEXT:     arith.constant {{[0-9]+}} : i32
//  CHECK-NEXT:     llvm.call @tai_rt_go_on
tai.kernel @search(%x: memref<?xf32>, %limit: f32) {
  %c0 = arith.constant 0 : index
  %n = memref.dim %x, %c0 : memref<?xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    scf.while : () -> () {
      %0 = memref.load %x[%i] : memref<?xf32>
      %1 = arith.cmpf olt, %0, %limit : f32
      scf.condition(%1)
    } do {
      %0 = memref.load %x[%i] : memref<?xf32>
      %1 = arith.addf %0, %0 : f32
      memref.store %1, %x[%i] : memref<?xf32>
      scf.yield
    }
  }
  tai.return
}

// -----

// A thread that is alone asks in any loop of unknown length.
// CHECK-LABEL: llvm.func @alone_0(
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:       llvm.call @tai_rt_go_on
tai.kernel @alone(%x: memref<?xf32>, %count: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%c1) {
    scf.for %j = %c0 to %count step %c1 {
      %0 = memref.load %x[%i] : memref<?xf32>
      %1 = arith.mulf %0, %0 : f32
      memref.store %1, %x[%i] : memref<?xf32>
    }
  }
  tai.return
}

// -----

// The iterations of a thread, where there may be 2^63 of them.
// CHECK-LABEL: llvm.func @countless_0(
//       CHECK:   scf.for
//       CHECK:     %[[EVERY:.+]] = arith.constant {{[0-9]+}} : i32
//       CHECK:     llvm.call @tai_rt_go_on(%{{.+}}, %[[EVERY]])
tai.kernel @countless(%x: memref<?xf32>, %count: i64) {
  %c0 = arith.constant 0 : index
  %n = arith.index_cast %count : i64 to index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = memref.load %x[%c0] : memref<?xf32>
    %1 = arith.mulf %0, %0 : f32
    memref.store %1, %x[%c0] : memref<?xf32>
  }
  tai.return
}

// -----

// CHECK-LABEL: llvm.func @constant_0(
//       CHECK:   llvm.call @tai_rt_go_on
tai.kernel @constant(%x: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %many = arith.constant 1152921504606846976 : index
  tai.parallel_for (%i) = (%c0) to (%many) {
    %0 = memref.load %x[%c0] : memref<?xf32>
    %1 = arith.mulf %0, %0 : f32
    memref.store %1, %x[%c0] : memref<?xf32>
  }
  tai.return
}

// -----

// No more than 2^31: the grid has run them within a second.
// CHECK-LABEL: llvm.func @counted_0(
//   CHECK-NOT:   tai_rt_go_on
tai.kernel @counted(%x: memref<?xf32>, %count: i32, %long: i64) {
  %c0 = arith.constant 0 : index
  %n = arith.index_cast %count : i32 to index
  %wide = arith.extsi %count : i32 to i64
  %m = arith.index_cast %wide : i64 to index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = memref.load %x[%c0] : memref<?xf32>
    %1 = arith.mulf %0, %0 : f32
    memref.store %1, %x[%c0] : memref<?xf32>
  }
  tai.parallel_for (%i) = (%c0) to (%m) {
    %0 = memref.load %x[%c0] : memref<?xf32>
    %1 = arith.mulf %0, %0 : f32
    memref.store %1, %x[%c0] : memref<?xf32>
  }
  tai.return
}
