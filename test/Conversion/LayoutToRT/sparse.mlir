// RUN: tai-opt %s --split-input-file --tai-lower-struct-for | FileCheck %s --check-prefix=LOOP
// RUN: tai-opt %s --split-input-file --tai-scalarize --tai-lower-struct-for --tai-lower-layout --canonicalize --cse | FileCheck %s

// A loop over a sparse field runs over the list of active cells, and over the
// dense levels below each. Its own cell is known to be active.
tai.tree @t : !tai.root<pointer<[i: 4, j: 2], dense<[i: 8, j: 16], {x: f32, y: f32}>>>
tai.field @x = @t["x"] : f32, rank 2
tai.field @y = @t["y"] : f32, rank 2

// LOOP-LABEL: tai.kernel @visit
//       LOOP:   %[[BASE:.+]] = tai_rt.tree_base @t
//       LOOP:   %[[CELLS:.+]], %[[COUNT:.+]] = tai_rt.active_cells %[[BASE]], 0
//       LOOP:   tai.parallel_for (%[[E:.+]], %[[DI:.+]], %[[DJ:.+]]) = ({{.*}}) to (%[[COUNT]],
//       LOOP:     %[[CELL:.+]] = llvm.load {{.*}} invariant
//       LOOP:     tai.store {{.*}}, @y[{{.*}}] {tai.active}
//       LOOP:   } {outer_dims = 1 : i64}
tai.kernel @visit() {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @x[%i, %j] : f32
    tai.store %0, @y[%i, %j] : f32
  }
  tai.return
}

// The indices of the first element of each cell.
// LOOP-LABEL: tai.kernel @visit_level
//       LOOP:   tai_rt.active_cells
//       LOOP:   tai.parallel_for (%{{[^,]+}}) = (%{{[^,]+}}) to (%{{[^,]+}})
tai.kernel @visit_level() {
  tai.parallel_for (%i, %j) in @x level 2 {
    tai.deactivate @x[%i, %j] level 2
  }
  tai.return
}

// A kernel may deactivate the cells that it visits.
// LOOP-LABEL: tai.kernel @changes
//   LOOP-NOT:   tai.active}
tai.kernel @changes() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i, %j) in @x {
    tai.deactivate @x[%i, %j] level 2
    tai.store %zero, @y[%i, %j] : f32
  }
  tai.return
}

// A read asks nothing: inactive memory is zero.
// CHECK-LABEL: tai.kernel @read
//   CHECK-NOT:   llvm.load {{.*}} atomic
//       CHECK:   tai.return
tai.kernel @read(%i: index, %j: index) -> f32 {
  %0 = tai.load @x[%i, %j] : f32
  tai.return %0 : f32
}

// A write tests the bit of the cell, and calls where it is clear.
// CHECK-LABEL: tai.kernel @write
//       CHECK:   %[[WORD:.+]] = llvm.load {{.*}} atomic monotonic {{.*}} -> i64
//       CHECK:   %[[ACTIVE:.+]] = arith.trunci {{.*}} : i64 to i1
//       CHECK:   %[[OK:.+]] = scf.if %[[ACTIVE]]
//       CHECK:     tai_rt.activate_cell {{.*}}, 0,
//       CHECK:   scf.if %[[OK]] {
//       CHECK:     llvm.store
tai.kernel @write(%i: index, %j: index, %v: f32) {
  tai.store %v, @x[%i, %j] : f32
  tai.return
}

// An adjoint adds nothing to inactive cells.
// CHECK-LABEL: tai.kernel @adjoint
//   CHECK-NOT:   tai_rt.activate_cell
//       CHECK:   %[[ACTIVE:.+]] = arith.trunci {{.*}} : i64 to i1
//       CHECK:   scf.if %[[ACTIVE]] {
tai.kernel @adjoint(%i: index, %j: index, %v: f32)
    attributes {keeps_activity} {
  %0 = tai.atomic add %v, @x[%i, %j] : f32
  tai.return
}

// CHECK-LABEL: tai.kernel @ask
//       CHECK:   tai_rt.activate_cell
//       CHECK:   tai_rt.deactivate_cell
//       CHECK:   llvm.load {{.*}} atomic monotonic
//       CHECK:   %[[TRUE:.+]] = arith.trunci
//       CHECK:   tai.return %[[TRUE]]
tai.kernel @ask(%i: index, %j: index) -> i1 {
  tai.activate @x[%i, %j] level 1
  tai.deactivate @x[%i, %j] level 2
  %0 = tai.is_active @x[%i, %j] level 1
  tai.return %0 : i1
}

// -----

// A list grows by a cell, if it is not full.
tai.tree @t : !tai.root<dense<[i: 3], dynamic<[j: 16], chunk 4, {x: vector<2xf32>}>>>
tai.field @x = @t["x"] : vector<2xf32>, rank 2

// CHECK-LABEL: tai.kernel @append
//       CHECK:   %[[AT:.+]] = tai_rt.append_cell {{.*}}, 0, %{{.+}}
//       CHECK:   %[[HAS:.+]] = arith.cmpi sge, %[[AT]]
//       CHECK:   scf.if %[[HAS]] {
//       CHECK:     llvm.store
//       CHECK:     llvm.store
//       CHECK:   %[[LENGTH:.+]] = llvm.load {{.*}} atomic monotonic {{.*}} -> i32
tai.kernel @append(%i: index, %v: vector<2xf32>) -> i64 {
  %0 = tai.append %v, @x[%i] : vector<2xf32>
  %1 = tai.length @x[%i]
  %2 = arith.addi %0, %1 : index
  %3 = arith.index_cast %2 : index to i64
  tai.return %3 : i64
}

// -----

// The length of a list is that of the innermost one, whatever lies in its
// cells.

tai.tree @t : !tai.root<dense<[i: 3], dynamic<[j: 8], chunk 1, pointer<[k: 4], {x: f32}>>>>
tai.field @x = @t["x"] : f32, rank 3

// CHECK-LABEL: tai.kernel @length
//       CHECK:   %[[LENGTH:.+]] = llvm.load {{.*}} atomic monotonic {{.*}} -> i32
tai.kernel @length(%i: index, %k: index) -> i64 {
  %0 = tai.length @x[%i, %k]
  %1 = arith.index_cast %0 : index to i64
  tai.return %1 : i64
}

// -----

// Two fields below one level: equal indices are the same cell only where both
// divide the levels below alike.
tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: f32}>, dense<[i: 2], {y: f32}>, dense<[i: 8], {z: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @z = @t["z"] : f32, rank 1

// LOOP-LABEL: tai.kernel @siblings
//       LOOP:   tai.store {{.*}}, @y[%{{[^]]*}}] : f32
//       LOOP:   tai.store {{.*}}, @z[%{{[^]]*}}] {tai.active} : f32
// CHECK-LABEL: tai.kernel @siblings
//       CHECK:   tai_rt.activate_cell
//   CHECK-NOT:   tai_rt.activate_cell
//       CHECK:   tai.return
tai.kernel @siblings() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
    tai.store %0, @z[%i] : f32
  }
  tai.return
}
