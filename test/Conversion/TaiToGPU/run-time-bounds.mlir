// RUN: tai-opt %s --tai-narrow-indices --tai-lower-layout --convert-tai-to-gpu | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

// With 32 bits for an index, the number of iterations may be 2^31 - 1. The last
// thread of a grid adds a stride to that before it compares.
// CHECK:       gpu.module @kernels attributes {tai.index_bits = 32 : i64}
// CHECK-LABEL: llvm.func @run_time_0(
//       CHECK:   scf.for unsigned %
tai.kernel @run_time(%n: i32) {
  %c0 = arith.constant 0 : index
  %end = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%c0) to (%end) {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}

// A constant number of iterations is not as large.
// CHECK-LABEL: llvm.func @constant_0(
//       CHECK:   scf.for %
tai.kernel @constant() {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @x[%i] : f32
  }
  tai.return
}
