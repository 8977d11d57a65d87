// RUN: tai-opt %s --convert-tai-to-scf | FileCheck %s
// RUN: tai-opt %s --convert-tai-to-scf=debug=true | FileCheck %s --check-prefix=DEBUG
// RUN: tai-opt %s --tai-fix-sum-order --tai-relax-atomics --tai-lower-layout --convert-tai-to-scf | FileCheck %s --check-prefix=DET

tai.tree @s : !tai.root<dense<[i: 8], {a: f32}>>
tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>

// Arguments come from slots, the result goes to one, and the status says that
// nothing can fail here.
// CHECK-LABEL: llvm.func @arguments(
//  CHECK-SAME:     %[[FRAME:.+]]: !llvm.ptr) -> i32
//       CHECK:   %[[P:.+]] = llvm.getelementptr inbounds %[[FRAME]][8]
//       CHECK:   %[[ARGS:.+]] = llvm.load %[[P]] invariant
//       CHECK:   %[[X:.+]] = llvm.load %[[ARGS]] : !llvm.ptr -> f32
//       CHECK:   %[[S1:.+]] = llvm.getelementptr inbounds %[[ARGS]][1] : (!llvm.ptr) -> !llvm.ptr, i64
//       CHECK:   %[[N:.+]] = llvm.load %[[S1]] : !llvm.ptr -> i32
//       CHECK:   %[[Y:.+]] = arith.sitofp %[[N]]
//       CHECK:   %[[Z:.+]] = arith.addf %[[X]], %[[Y]]
//       CHECK:   %[[R:.+]] = llvm.getelementptr inbounds %[[FRAME]][16]
//       CHECK:   %[[RESULTS:.+]] = llvm.load %[[R]]
//       CHECK:   llvm.store %[[Z]], %[[RESULTS]]
//       CHECK:   %[[OK:.+]] = arith.constant 0 : i32
//       CHECK:   llvm.return %[[OK]]
tai.kernel @arguments(%x: f32, %n: i32) -> f32 {
  %0 = arith.sitofp %n : i32 to f32
  %1 = arith.addf %x, %0 : f32
  tai.return %1 : f32
}

// An array is a pointer and an extent for each dimension.
// CHECK-LABEL: llvm.func @array(
//       CHECK:   %[[ARGS:.+]] = llvm.load %{{.+}} invariant : !llvm.ptr -> !llvm.ptr
//       CHECK:   %[[A:.+]] = llvm.load %[[ARGS]] : !llvm.ptr -> !llvm.ptr
//       CHECK:   %[[D:.+]] = llvm.load %{{.+}} : !llvm.ptr -> i64
//       CHECK:   %[[E:.+]] = arith.index_cast %[[D]] : i64 to index
//       CHECK:   llvm.store %{{.+}}, %[[A]] : f32, !llvm.ptr
//       CHECK:   %[[I:.+]] = arith.index_cast %[[E]] : index to i64
//       CHECK:   llvm.store %[[I]], %{{.+}} : i64, !llvm.ptr
tai.kernel @array(%m: memref<?xf32>, %x: f32) -> i64 {
  %c0 = arith.constant 0 : index
  %0 = memref.extract_aligned_pointer_as_index %m : memref<?xf32> -> index
  %1 = arith.index_cast %0 : index to i64
  %2 = llvm.inttoptr %1 : i64 to !llvm.ptr
  llvm.store %x, %2 : f32, !llvm.ptr
  %3 = memref.dim %m, %c0 : memref<?xf32>
  %4 = arith.index_cast %3 : index to i64
  tai.return %4 : i64
}

// A tree is found by its position.
// CHECK-LABEL: llvm.func @tree(
//  CHECK-SAME:     %[[FRAME:.+]]: !llvm.ptr)
//       CHECK:   %[[TREES:.+]] = llvm.load %[[FRAME]] invariant
//       CHECK:   %[[AT:.+]] = llvm.getelementptr inbounds %[[TREES]][8]
//       CHECK:   llvm.load %[[AT]] invariant : !llvm.ptr -> !llvm.ptr
//   CHECK-NOT: tai.tree
tai.kernel @tree() -> f32 {
  %0 = tai_rt.tree_base @t : !llvm.ptr
  %1 = llvm.load %0 : !llvm.ptr -> f32
  tai.return %1 : f32
}

// The bits of adjoints that count as zero are read from the frame, in the function
// of the kernel and in that of its loop; the list travels to the function.
// CHECK-LABEL: llvm.func @stored_first(
//  CHECK-SAME:     %[[FRAME:.+]]: !llvm.ptr)
//  CHECK-SAME:     ["tai.stores_first", "a_grad,b_grad"]
//       CHECK:   %[[AT:.+]] = llvm.getelementptr inbounds %[[FRAME]][56]
//       CHECK:   %[[BITS:.+]] = llvm.load %[[AT]] invariant : !llvm.ptr -> i64
//       CHECK:   %[[TWO:.+]] = arith.constant 2 : i64
//       CHECK:   %[[BIT:.+]] = arith.andi %[[BITS]], %[[TWO]]
//       CHECK:   arith.cmpi ne, %[[BIT]]
tai.kernel @stored_first() -> i1 attributes {tai.stores_first = ["a_grad", "b_grad"]} {
  %0 = tai_rt.starts_at_zero 1
  tai.return %0 : i1
}

// One dimension: the partition is a range of the index. Values from outside of
// the body travel in the closure; constants are copied.
// CHECK-LABEL: llvm.func @range(
//  CHECK-SAME:     %[[FRAME:.+]]: !llvm.ptr)
//       CHECK:   %[[CLOSURE:.+]] = llvm.alloca %{{.+}} x !llvm.array<1 x i64>
//       CHECK:   %[[X:.+]] = llvm.load %{{.+}} : !llvm.ptr -> f32
//       CHECK:   %[[PARTS:.+]] = llvm.call @tai_rt_parts(%[[FRAME]], %[[N:.+]], %{{.+}}, %[[FIXED:.+]])
//       CHECK:   %[[BODY:.+]] = llvm.mlir.addressof @range.loop0
//       CHECK:   llvm.store %[[X]], %{{.+}} : f32, !llvm.ptr
//       CHECK:   llvm.call @tai_rt_parallel_for(%[[FRAME]], %[[BODY]], %[[CLOSURE]], %[[N]], %[[PARTS]])
// CHECK-LABEL: llvm.func internal @range.loop0(
//  CHECK-SAME:     %{{.+}}: !llvm.ptr, %[[C:.+]]: !llvm.ptr, %[[BEGIN:.+]]: i64, %[[END:.+]]: i64, %{{.+}}: i64)
//       CHECK:   arith.constant 5.0
//       CHECK:   %[[B:.+]] = arith.index_cast %[[BEGIN]] : i64 to index
//       CHECK:   %[[E:.+]] = arith.index_cast %[[END]] : i64 to index
//       CHECK:   scf.for %{{.+}} = %[[B]] to %[[E]] step
//       CHECK:   llvm.return
//   DET-LABEL: llvm.func @range(
//         DET:   %[[FIXED:.+]] = arith.constant 2 : i32
//         DET:   llvm.call @tai_rt_parts(%{{.+}}, %{{.+}}, %{{.+}}, %[[FIXED]])
tai.kernel @range(%x: f32) {
  %five = arith.constant 5.0 : f32
  %c0 = arith.constant 0 : index
  %n = arith.constant 100000 : index
  %p = tai_rt.tree_base @t : !llvm.ptr
  tai.parallel_for (%i) = (%c0) to (%n) {
    %0 = arith.addf %x, %five : f32
    %1 = arith.index_cast %i : index to i64
    %2 = llvm.getelementptr %p[%1] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    llvm.store %0, %2 : f32, !llvm.ptr
  }
  tai.return
}

// A sum of integers is made again in the body, where LLVM sees the distance of
// two slots: one value travels.
// CHECK-LABEL: llvm.func @slots(
//       CHECK:   llvm.alloca %{{.+}} x !llvm.array<1 x i64>
// CHECK-LABEL: llvm.func internal @slots.loop0(
//       CHECK:   %[[T:.+]] = llvm.load %{{.+}} : !llvm.ptr -> i32
//       CHECK:   %[[SLOT:.+]] = arith.index_cast %[[T]] : i32 to index
//       CHECK:   %[[NEXT:.+]] = arith.addi %[[SLOT]], %{{.+}} : index
//       CHECK:   scf.for
//       CHECK:     arith.muli %[[NEXT]]
tai.kernel @slots(%t: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %n = arith.constant 100000 : index
  %slot = arith.index_cast %t : i32 to index
  %next = arith.addi %slot, %c1 : index
  %p = tai_rt.tree_base @t : !llvm.ptr
  tai.parallel_for (%i) = (%c0) to (%n) {
    %from = arith.addi %slot, %i : index
    %to = arith.muli %next, %n : index
    %0 = arith.index_cast %from : index to i64
    %1 = llvm.getelementptr %p[%0] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %2 = llvm.load %1 : !llvm.ptr -> f32
    %3 = arith.index_cast %to : index to i64
    %4 = llvm.getelementptr %p[%3] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    llvm.store %2, %4 : f32, !llvm.ptr
  }
  tai.return
}

// Many rows: the partition counts rows, and the inner loop is whole.
// CHECK-LABEL: llvm.func internal @rows.loop0(
//       CHECK:   scf.for
//       CHECK:     scf.for %{{.+}} = %[[ZERO:.+]] to %[[N:.+]] step
tai.kernel @rows() {
  %c0 = arith.constant 0 : index
  %n = arith.constant 1000 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %n) {
    tai.print "{}"(%j) : index
  }
  tai.return
}

// Few rows: the partition counts iterations, and its first and last rows are
// partial.
// CHECK-LABEL: llvm.func internal @few_rows.loop0(
//       CHECK:   arith.divui
//       CHECK:   scf.for %[[ROW:.+]] =
//       CHECK:     arith.muli %[[ROW]]
//       CHECK:     arith.maxsi
//       CHECK:     arith.minsi
//       CHECK:     scf.for
tai.kernel @few_rows() {
  %c0 = arith.constant 0 : index
  %m = arith.constant 3 : index
  %n = arith.constant 100000 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%m, %n) {
    tai.print "{}"(%j) : index
  }
  tai.return
}

// Bounds known at run time: an empty box runs nothing.
// CHECK-LABEL: llvm.func @dynamic(
//       CHECK:   arith.cmpi sgt
//       CHECK:   scf.if
//       CHECK:     llvm.call @tai_rt_parallel_for
tai.kernel @dynamic(%n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %n) {
    tai.print "{}"(%j) : index
  }
  tai.return
}

// On one thread: in place.
// CHECK-LABEL: llvm.func @serial(
//   CHECK-NOT:   tai_rt_parallel_for
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:   llvm.return
tai.kernel @serial(%n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %n) serialize {
    tai.print "{}"(%j) : index
  }
  tai.return
}

// A local is on the stack of the function, made once, and zero where the
// program makes it.
// CHECK-LABEL: llvm.func internal @local.loop0(
//       CHECK:   %[[SLOT:.+]] = llvm.alloca
//       CHECK:   scf.for
//   CHECK-NOT:     llvm.alloca
//       CHECK:     %[[ZERO:.+]] = arith.constant 0.0
//       CHECK:     llvm.store %[[ZERO]], %[[SLOT]]
//       CHECK:     llvm.load %[[SLOT]] : !llvm.ptr -> f32
tai.kernel @local(%n: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %l = tai.alloca : !tai.local<f32>
    %0 = tai.local_load %l : f32
    tai.local_store %0, %l : f32
  }
  tai.return
}

// Assertions are for debug mode, but for those on indices.
// CHECK-LABEL: llvm.func @checks(
//       CHECK:   scf.if
//       CHECK:     %[[INDEX:.+]] = arith.constant 2 : i32
//       CHECK:     llvm.call @tai_rt_fail(%{{.+}}, %[[INDEX]],
//   CHECK-NOT:   llvm.call @tai_rt_fail
//       CHECK:   %[[STATUS:.+]] = llvm.call @tai_rt_failed
//       CHECK:   llvm.return %[[STATUS]]
// DEBUG-LABEL: llvm.func @checks(
//       DEBUG:     %[[ASSERT:.+]] = arith.constant 1 : i32
//       DEBUG:     llvm.call @tai_rt_fail(%{{.+}}, %[[ASSERT]],
//       DEBUG:     %[[INDEX:.+]] = arith.constant 2 : i32
//       DEBUG:     llvm.call @tai_rt_fail(%{{.+}}, %[[INDEX]],
tai.kernel @checks(%c: i1, %x: f32) {
  tai.assert %c, "x is {}"(%x) : f32
  tai.assert %c, "index" {failure = 2 : i32}
  tai.return
}

// A draw is numbered by the position in the box, and counted where it repeats.
// CHECK-LABEL: llvm.func internal @random.loop0(
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:       %[[AT:.+]] = arith.index_cast %{{.+}} : index to i64
//       CHECK:       %[[STREAM:.+]] = arith.constant 3 : i32
//       CHECK:       arith.extui %[[STREAM]]
// CHECK-COUNT-18:      arith.muli
//       CHECK:       arith.shrui
//       CHECK:       arith.sitofp
//       CHECK:       arith.mulf
//       CHECK:       scf.for
//       CHECK:         %[[COUNT:.+]] = llvm.load %[[COUNTER:.+]] : !llvm.ptr -> i32
//       CHECK:         %[[NEXT:.+]] = arith.addi %[[COUNT]]
//       CHECK:         llvm.store %[[NEXT]], %[[COUNTER]]
//       CHECK:         arith.shrui %[[COUNT]]
//       CHECK:         arith.sitofp
tai.kernel @random(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %p = tai_rt.tree_base @t : !llvm.ptr
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%n, %n) {
    %0 = tai.random stream 3 : f32
    llvm.store %0, %p : f32, !llvm.ptr
    scf.for %k = %c0 to %n step %c1 {
      %1 = tai.random stream 4 : f64
      llvm.store %1, %p : f64, !llvm.ptr
    }
  }
  tai.return
}
