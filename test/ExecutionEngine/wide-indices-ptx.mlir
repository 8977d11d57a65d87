// RUN: tai-opt %s --tai-to-nvvm | tai-translate --tai-to-ptx --device-target=sm_90 | FileCheck %s

// Bounds of 64 bits are compared in 64 bits on the device, and an index of 64
// bits is not cut on its way to the access.
// CHECK-LABEL: .entry wide_0
//   CHECK-NOT: cvt.u32.u64
//       CHECK: setp.{{ge|gt|lt|le}}.{{s|u}}64
//   CHECK-NOT: cvt.u32.u64
//       CHECK: st.global.b64
tai.tree @t : !tai.root<dense<[i: 64], {x: i64}>>
tai.field @x = @t["x"] : i64, rank 1
tai.kernel @wide(%m: i64, %n: i64) {
  %begin = arith.index_cast %m : i64 to index
  %end = arith.index_cast %n : i64 to index
  tai.parallel_for (%i) = (%begin) to (%end) {
    %0 = arith.subi %i, %begin : index
    %1 = arith.index_cast %i : index to i64
    tai.store %1, @x[%0] : i64
  }
  tai.return
}
