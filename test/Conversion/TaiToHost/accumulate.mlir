// RUN: tai-opt %s --convert-tai-to-scf | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 4, j: 100], {g: vector<2xf32>}>,
                        dense<[i: 100], {h: f32, other: i32}>, {loss: f32}>
tai.field @g = @t["g"] : vector<2xf32>, rank 2
tai.field @h = @t["h"] : f32, rank 1
tai.field @loss = @t["loss"] : f32, rank 0

// The partition sums blocks of iterations in a slot of its stack, with the order
// of the sum left to LLVM, and the blocks in f64; the kernel adds the partial
// sums in order. One partition needs no memory for them.
// CHECK-LABEL: llvm.func @reduction(
//       CHECK:   %[[PARTS:.+]] = llvm.call @tai_rt_parts
//       CHECK:   %[[ROOM:.+]] = scf.if %{{.+}} -> (!llvm.ptr)
//       CHECK:     scf.yield
//       CHECK:   } else {
//       CHECK:     llvm.call @tai_rt_scratch
//       CHECK:   llvm.call @tai_rt_parallel_for
//       CHECK:   %[[ZERO:.+]] = arith.constant 0.0
//       CHECK:   %[[SUM:.+]] = scf.for {{.+}} iter_args(%[[S:.+]] = %[[ZERO]]) -> (f64)
//       CHECK:     %[[P:.+]] = llvm.load
//       CHECK:     llvm.fadd %[[S]], %[[P]] : f64
//       CHECK:   %[[F32:.+]] = arith.truncf %[[SUM]] : f64 to f32
//       CHECK:   %[[OLD:.+]] = llvm.load
//       CHECK:   %[[NEW:.+]] = arith.addf %[[OLD]], %[[F32]]
//       CHECK:   llvm.store %[[NEW]]
// CHECK-LABEL: llvm.func internal @reduction.loop0(
//       CHECK:   %[[TOTAL:.+]] = llvm.alloca
//       CHECK:   %[[SLOT:.+]] = llvm.alloca
//       CHECK:   llvm.store %{{.+}}, %[[SLOT]] : f32
//       CHECK:   llvm.store %{{.+}}, %[[TOTAL]] : f64
//       CHECK:   scf.for {{.+}} step %c8192
//       CHECK:     scf.for
//       CHECK:       %[[A:.+]] = llvm.load %[[SLOT]]
//       CHECK:       %[[B:.+]] = arith.subf %[[A]], %{{.+}} fastmath<reassoc,contract>
//       CHECK:       llvm.store %[[B]], %[[SLOT]]
//       CHECK:     %[[BLOCK:.+]] = llvm.load %[[SLOT]]
//       CHECK:     %[[WIDE:.+]] = arith.extf %[[BLOCK]] : f32 to f64
//       CHECK:     %[[BEFORE:.+]] = llvm.load %[[TOTAL]]
//       CHECK:     %[[AFTER:.+]] = arith.addf %[[BEFORE]], %[[WIDE]] : f64
//       CHECK:     llvm.store %[[AFTER]], %[[TOTAL]]
//       CHECK:   llvm.load %[[SLOT]]
//       CHECK:   llvm.store %{{.+}}, %[[TOTAL]]
//       CHECK:   %[[ALL:.+]] = llvm.load %[[TOTAL]]
//       CHECK:   llvm.store %[[ALL]]
tai.kernel @reduction(%x: f32, %n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = tai.atomic sub %x, @loss[] reduction <register own any block 8192> : f32
  }
  tai.return
}

// A slice that fills its memory: the buffer has the layout of the field, and
// one partition updates the field itself. More partitions than their buffers
// are worth are not made.
// CHECK-LABEL: llvm.func @slice(
//       CHECK:   llvm.call @tai_rt_parts
//       CHECK:   %[[PARTS:.+]] = arith.minsi
//       CHECK:   %[[ROUNDED:.+]] = arith.constant 832 : i64
//       CHECK:   %[[BUFFER:.+]] = scf.if %{{.+}} -> (!llvm.ptr)
//       CHECK:     scf.yield %[[TARGET:.+]] : !llvm.ptr
//       CHECK:   } else {
//       CHECK:     %[[BYTES:.+]] = arith.constant 800 : i64
//       CHECK:     llvm.call @tai_rt_private(%{{.+}}, %[[BYTES]], %[[PARTS]])
//       CHECK:   llvm.call @tai_rt_parallel_for
//       CHECK:   scf.if
//       CHECK:     %[[COUNT:.+]] = arith.constant 200 : i64
//       CHECK:     llvm.call @tai_rt_combine(%{{.+}}, %[[TARGET]], %[[BUFFER]], %[[COUNT]], %[[PARTS]], %{{.+}})
// CHECK-LABEL: llvm.func internal @slice.loop0(
//       CHECK:   scf.for %[[J:.+]] =
//       CHECK:     %[[TWO:.+]] = arith.constant 2 : index
//       CHECK:     arith.muli %[[J]], %[[TWO]]
//   CHECK-NOT:     atomicrmw
//       CHECK:     %[[OLD:.+]] = llvm.load
//       CHECK:     arith.addf %[[OLD]]
//       CHECK:     llvm.store
tai.kernel @slice(%t: index, %x: f32, %n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%j) = (%c0) to (%n) {
    %0 = tai.atomic add %x, @g[%t, %j] component [%c1] reduction <buffer own any buffer 0> : f32
  }
  tai.return
}

// Many updates of each element: sums in f64, in buffers of all partitions.
// CHECK-LABEL: llvm.func @wide(
//   CHECK-NOT:   scf.yield
//       CHECK:   %[[BYTES:.+]] = arith.constant 800 : i64
//       CHECK:   %[[BUFFER:.+]] = llvm.call @tai_rt_private(%{{.+}}, %[[BYTES]], %{{.+}})
//       CHECK:   llvm.call @tai_rt_parallel_for
//       CHECK:   %[[WIDE:.+]] = arith.constant 2 : i32
//       CHECK:   llvm.call @tai_rt_combine_strided(%{{.+}}, %{{.+}}, %[[BUFFER]], {{.+}}, %[[WIDE]])
// CHECK-LABEL: llvm.func internal @wide.loop0(
//       CHECK:     %[[TERM:.+]] = arith.extf %{{.+}} : f32 to f64
//       CHECK:     %[[OLD:.+]] = llvm.load %{{.+}} : !llvm.ptr -> f64
//       CHECK:     arith.addf %[[OLD]], %[[TERM]] : f64
tai.kernel @wide(%j: index, %x: f32) {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  %c300 = arith.constant 300 : index
  tai.parallel_for (%i, %k) = (%c0, %c0) to (%c300, %c100) {
    %0 = tai.atomic add %x, @h[%k] reduction <buffer wide any buffer 0> : f32
  }
  tai.return
}

// Cells that hold other fields too: the buffer is compact, and the distance of
// its elements is known at run time, as one partition updates the field itself.
// CHECK-LABEL: llvm.func @strided(
//       CHECK:   %[[CELL:.+]] = arith.select %{{.+}}, %[[EIGHT:.+]], %[[FOUR:.+]] : i64
//       CHECK:   llvm.call @tai_rt_combine_strided
tai.kernel @strided(%x: f32, %n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%j) = (%c0) to (%n) {
    %0 = tai.atomic add %x, @h[%j] reduction <buffer own any buffer 0> : f32
  }
  tai.return
}

// An update under a condition moves behind it, where every iteration adds.
// CHECK-LABEL: llvm.func internal @conditional.loop0(
//       CHECK:   scf.for
//       CHECK:     %[[ADDED:.+]] = scf.if %{{.+}} -> (f32) {
//       CHECK:       scf.yield %{{.+}} : f32
//       CHECK:     } else {
//       CHECK:       %[[NONE:.+]] = arith.constant -0.0
//       CHECK:       scf.yield %[[NONE]] : f32
//       CHECK:     arith.addf %{{.+}}, %[[ADDED]] fastmath<reassoc,contract>
tai.kernel @conditional(%c: i1, %x: f32, %n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    scf.if %c {
      %0 = tai.atomic add %x, @loss[] reduction <register own any block 8192> : f32
    }
  }
  tai.return
}
