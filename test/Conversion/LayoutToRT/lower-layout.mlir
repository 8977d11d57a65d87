// RUN: tai-opt %s --tai-lower-layout | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 4, j: 8], {x: f32, v: vector<2xf32>}>,
                        dense<[i: 4], dense<[i: 16], {b: f64}>>, {s: i32, f: i1},
                        dense<[i: 4], dense<[i: 16], {o: f64}>>>
tai.field @x = @t["x"] : f32, rank 2
tai.field @v = @t["v"] : vector<2xf32>, rank 2
tai.field @b = @t["b"] : f64, rank 1
tai.field @o = @t["o"] : f64, rank 1, offset [-3]
tai.field @s = @t["s"] : i32, rank 0
tai.field @f = @t["f"] : i1, rank 0

// The address is affine in the indices, in units of a component: a cell holds
// three floats, and @v starts one behind @x.
// CHECK-LABEL: tai.kernel @record(
//  CHECK-SAME:     %[[I:.+]]: index, %[[J:.+]]: index
//   CHECK-DAG:   %[[BASE:.+]] = tai_rt.tree_base @t : !llvm.ptr
//   CHECK-DAG:   %[[V:.+]] = llvm.getelementptr inbounds|nuw %[[BASE]][4]
//       CHECK:   %[[C24:.+]] = arith.constant 24 : index
//       CHECK:   %[[A:.+]] = arith.muli %[[I]], %[[C24]] overflow<nsw>
//       CHECK:   %[[C3:.+]] = arith.constant 3 : index
//       CHECK:   %[[B:.+]] = arith.muli %[[J]], %[[C3]] overflow<nsw>
//       CHECK:   %[[AT:.+]] = arith.addi %[[A]], %[[B]] overflow<nsw>
//       CHECK:   %[[AT64:.+]] = arith.index_cast %[[AT]] : index to i64
//       CHECK:   %[[P:.+]] = llvm.getelementptr inbounds|nuw %{{.+}}[%[[AT64]]] : (!llvm.ptr, i64) -> !llvm.ptr, f32
//       CHECK:   %[[X:.+]] = llvm.load %[[P]] {alias_scopes = [#[[SX:.+]]], noalias_scopes = [#[[SV:.+]]]}
//       CHECK:   llvm.store %[[X]], %{{.+}} {alias_scopes = [#[[SV]]], noalias_scopes = [#[[SX]]]}
tai.kernel @record(%i: index, %j: index) {
  %c1 = arith.constant 1 : index
  %0 = tai.load @x[%i, %j] : f32
  tai.store %0, @v[%i, %j] component [%c1] : f32
  tai.return
}

// An axis that two levels divide splits into digits: the outer one needs no
// remainder.
// CHECK-LABEL: tai.kernel @digits(
//  CHECK-SAME:     %[[I:.+]]: index
//       CHECK:   %[[C16:.+]] = arith.constant 16 : index
//       CHECK:   %[[OUTER:.+]] = arith.divui %[[I]], %[[C16]]
//       CHECK:   arith.muli %[[OUTER]], %{{.+}} overflow<nsw>
//       CHECK:   %[[INNER:.+]] = arith.remui %[[I]], %{{.+}}
//       CHECK:   llvm.load %{{.+}} -> f64
tai.kernel @digits(%i: index) -> f64 {
  %0 = tai.load @b[%i] : f64
  tai.return %0 : f64
}

// The offset of the field is subtracted. Two fields never overlap: each has a
// scope of its own.
// CHECK-LABEL: tai.kernel @offset(
//  CHECK-SAME:     %[[I:.+]]: index
//       CHECK:   llvm.load %{{.+}} {alias_scopes = [#[[S:.+]]], noalias_scopes = [{{.+}}]}
//       CHECK:   %[[M3:.+]] = arith.constant -3 : index
//       CHECK:   arith.subi %[[I]], %[[M3]] overflow<nsw>
//       CHECK:   llvm.store {{.+}} {alias_scopes = [#[[O:.+]]], noalias_scopes = [{{.*}}#[[S]]
tai.kernel @offset(%i: index) {
  %0 = tai.load @b[%i] : f64
  tai.store %0, @o[%i] : f64
  tai.return
}

// i1 takes a byte.
// CHECK-LABEL: tai.kernel @flag
//       CHECK:   %[[B:.+]] = llvm.load %{{.+}} -> i8
//       CHECK:   %[[F:.+]] = arith.trunci %[[B]] : i8 to i1
//       CHECK:   %[[E:.+]] = arith.extui %[[F]] : i1 to i8
//       CHECK:   llvm.store %[[E]]
tai.kernel @flag() {
  %0 = tai.load @f[] : i1
  tai.store %0, @f[] : i1
  tai.return
}

// One instruction where there is one, a loop around an exchange else, and a
// plain update where no other thread is near.
// CHECK-LABEL: tai.kernel @atomics(
//       CHECK:   llvm.atomicrmw fadd {{.+}} monotonic
//       CHECK:   llvm.atomicrmw fmaximum
//       CHECK:   llvm.atomicrmw add {{.+}} : !llvm.ptr, i32
//       CHECK:   scf.while
//       CHECK:     arith.mulf
//       CHECK:     llvm.cmpxchg {{.+}} monotonic monotonic
//       CHECK:   %[[OLD:.+]] = llvm.load
//       CHECK:   %[[NEW:.+]] = arith.subf %[[OLD]]
//       CHECK:   llvm.store %[[NEW]]
tai.kernel @atomics(%i: index, %x: f32, %n: i32) {
  %0 = tai.atomic add %x, @x[%i, %i] : f32
  %1 = tai.atomic max %x, @x[%i, %i] : f32
  %2 = tai.atomic add %n, @s[] : i32
  %3 = tai.atomic mul %x, @x[%i, %i] : f32
  %4 = tai.atomic sub %x, @x[%i, %i] exclusive : f32
  tai.return
}

// Arrays of the caller are row-major; their extents are known at run time.
// CHECK-LABEL: tai.kernel @array(
//  CHECK-SAME:     %[[M:.+]]: memref<?x?xf32>, %[[I:.+]]: index
//       CHECK:   %[[D1:.+]] = memref.dim %[[M]], %c1
//       CHECK:   arith.muli %{{.+}}, %[[D1]] overflow<nsw>
//       CHECK:   memref.extract_aligned_pointer_as_index %[[M]]
//       CHECK:   llvm.load %{{.+}} {alias_scopes = [#[[ARRAYS:.+]]], noalias_scopes = [{{.+}}]}
tai.kernel @array(%m: memref<?x?xf32>, %i: index) -> f32 {
  %0 = memref.load %m[%i, %i] : memref<?x?xf32>
  tai.return %0 : f32
}

// Functions of others may have arrays of any kind: they are not read as if they
// were row-major, without an offset, and of numbers.
// CHECK-LABEL: func.func @foreign(
//  CHECK-NEXT:   memref.load
//  CHECK-NEXT:   memref.load
//  CHECK-NEXT:   memref.store
//  CHECK-NEXT:   memref.load
//  CHECK-NEXT:   return
func.func @foreign(%strided: memref<4xf64, strided<[2], offset: 1>>,
                   %complex: memref<4xcomplex<f64>>, %shared: memref<4xf64, 3>,
                   %i: index) -> (f64, f64) {
  %0 = memref.load %strided[%i] : memref<4xf64, strided<[2], offset: 1>>
  %1 = memref.load %complex[%i] : memref<4xcomplex<f64>>
  memref.store %1, %complex[%i] : memref<4xcomplex<f64>>
  %2 = memref.load %shared[%i] : memref<4xf64, 3>
  return %0, %2 : f64, f64
}

// Sums that tai-relax-atomics took out of memory stay for convert-tai-to-scf.
// CHECK-LABEL: tai.kernel @kept
//       CHECK:   tai.atomic add %{{.+}}, @x[{{.+}}] reduction <buffer own any buffer 0>
tai.kernel @kept(%i: index, %x: f32) {
  %0 = tai.atomic add %x, @x[%i, %i] reduction <buffer own any buffer 0> : f32
  tai.return
}
