// RUN: tai-opt %s --tai-vectorize-iterations --split-input-file | FileCheck %s

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// Whole vectors first, then the iterations that are left. A branch that all
// iterations take alike stays one, and what all share is put before the loop.
// CHECK-LABEL: func.func @stencil(
//  CHECK-SAME:     %[[X:[^:]+]]: !llvm.ptr, %[[N:[^:]+]]: index, %[[C:[^:]+]]: i1, %[[S:[^:]+]]: f32)
//       CHECK:   %[[COUNT:.+]] = arith.andi %{{.+}}, %{{.+}} : index
//       CHECK:   %[[END:.+]] = arith.addi %[[LOWER:.+]], %[[COUNT]]
//       CHECK:   llvm.shufflevector {{.*}} [0, 0, 0, 0, 0, 0, 0, 0] : vector<8xf32>
//       CHECK:   scf.for %[[I:.+]] = %[[LOWER]] to %[[END]] step %{{.+}} {
//       CHECK:     %[[V:.+]] = llvm.load %{{.+}} {access_groups = [{{.+}}], alignment = 4 : i64} : !llvm.ptr -> vector<8xf32>
//       CHECK:     %[[R:.+]] = scf.if %[[C]] -> (vector<8xf32>) {
//       CHECK:       arith.mulf %[[V]], %{{.+}} : vector<8xf32>
//       CHECK:     arith.cmpf ogt, %[[R]], %[[V]] : vector<8xf32>
//       CHECK:     llvm.store %{{.+}} {access_groups = [{{.+}}], alignment = 4 : i64} : vector<8xf32>
//       CHECK:   scf.for %{{.+}} = %[[END]] to %[[N]]
//       CHECK:     llvm.load {{.*}} -> f32
func.func @stencil(%x: !llvm.ptr, %n: index, %c: i1, %s: f32) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  scf.for %i = %c1 to %n step %c1 {
    %before = arith.subi %i, %c1 : index
    %from = arith.index_cast %before : index to i64
    %p = llvm.getelementptr %x[%from] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
    %r = scf.if %c -> (f32) {
      %w = arith.mulf %v, %s : f32
      scf.yield %w : f32
    } else {
      scf.yield %v : f32
    }
    %more = arith.cmpf ogt, %r, %v : f32
    %y = arith.select %more, %r, %v : f32
    llvm.store %y, %p {access_groups = [#group]} : f32, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#parallel = #llvm.loop_annotation<parallelAccesses = #group>

// CHECK-NOT: vector

// Iterations may depend on one another.
func.func @dependent(%x: !llvm.ptr, %n: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %i = %c0 to %n step %c1 {
    %at = arith.index_cast %i : index to i64
    %p = llvm.getelementptr %x[%at] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %p : !llvm.ptr -> f32
    llvm.store %v, %p : f32, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}

// Not consecutive.
func.func @strided(%x: !llvm.ptr, %n: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  scf.for %i = %c0 to %n step %c1 {
    %twice = arith.muli %i, %c2 : index
    %at = arith.index_cast %twice : index to i64
    %p = llvm.getelementptr %x[%at] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f32
    llvm.store %v, %p {access_groups = [#group]} : f32, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}

// Shadows of f64 have no vectors.
func.func @wide(%x: !llvm.ptr, %n: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %i = %c0 to %n step %c1 {
    %at = arith.index_cast %i : index to i64
    %p = llvm.getelementptr %x[%at] : (!llvm.ptr, i64) -> !llvm.ptr, f64
    %v = llvm.load %p {access_groups = [#group]} : !llvm.ptr -> f64
    llvm.store %v, %p {access_groups = [#group]} : f64, !llvm.ptr
  } {llvm.loop_annotation = #parallel}
  return
}

// Iterations go different ways.
func.func @divergent(%x: !llvm.ptr, %n: index, %some: index) attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  scf.for %i = %c0 to %n step %c1 {
    %at = arith.index_cast %i : index to i64
    %p = llvm.getelementptr %x[%at] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %low = arith.cmpi slt, %i, %some : index
    scf.if %low {
      llvm.store %zero, %p {access_groups = [#group]} : f32, !llvm.ptr
    }
  } {llvm.loop_annotation = #parallel}
  return
}
