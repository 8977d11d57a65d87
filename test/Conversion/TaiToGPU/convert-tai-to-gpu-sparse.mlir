// RUN: tai-opt %s --split-input-file --tai-scalarize --tai-lower-struct-for --tai-relax-atomics=on-device --tai-lower-layout --convert-tai-to-gpu --verify-diagnostics | FileCheck %s

tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: f32, y: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1

// The list of active cells is made on the device; a loop captures its address,
// and that of its length, which the host does not know. Cells known to be
// active are not tested.
// CHECK-LABEL: llvm.func @visit_0(
//  CHECK-SAME:     %[[LENGTH:[^:]+]]: !llvm.ptr, %[[LIST:[^:]+]]: !llvm.ptr,
//       CHECK:   %[[NUMBER:.+]] = llvm.load %[[LENGTH]] : !llvm.ptr -> i64
//       CHECK:   %[[INDEX:.+]] = arith.index_cast %[[NUMBER]] : i64 to index
//       CHECK:   %[[SAFE:.+]] = arith.maxsi %[[INDEX]],
//       CHECK:   %[[TRIPS:.+]] = arith.muli %[[SAFE]],
//       CHECK:   scf.for %{{.+}} = %{{.+}} to %[[TRIPS]] step
//       CHECK:     %[[PLACE:.+]] = llvm.getelementptr {{.*}}%[[LIST]][
//       CHECK:     llvm.load %[[PLACE]] invariant {{.*}} -> i64
//   CHECK-NOT:   tai_rt_activate

// Code of the device changes activity itself, with the state of the device as
// its frame.
// CHECK-LABEL: llvm.func @write_0(
//  CHECK-SAME:     %[[STATE:[^:]+]]: !llvm.ptr, %[[TREE:[^:]+]]: !llvm.ptr
//       CHECK:   llvm.load {{.*}} atomic monotonic {{.*}} -> i64
//       CHECK:   llvm.call @tai_rt_activate(%[[STATE]], %[[TREE]],

// Serial code stays in front of the list that it may change.
// CHECK-LABEL: llvm.func @before_0(
//       CHECK:   llvm.call @tai_rt_deactivate
// CHECK-LABEL: llvm.func @before_1(

// CHECK-LABEL: llvm.func @visit(
//  CHECK-SAME:     %[[FRAME:.+]]: !llvm.ptr) -> i32
//       CHECK:   %[[COUNT:.+]] = llvm.call @tai_rt_active_cells(%[[FRAME]], %[[BASE:.+]], %{{.+}}, %[[SLOT:[0-9a-z_]+]])
//       CHECK:   %[[CELLS:.+]] = llvm.load %[[SLOT]]
//       CHECK:   %[[GUESS:.+]] = arith.index_cast %[[COUNT]]
//       CHECK:   %[[AT:.+]] = llvm.getelementptr %[[CELLS]][-1]
//   CHECK-NOT:   tai_rt_device_fetch
//       CHECK:   gpu.launch_func @kernels::@visit_0 {{.*}} args(%[[AT]] : !llvm.ptr, %[[CELLS]] : !llvm.ptr,
//   CHECK-NOT:   tai_rt_device_activates
tai.kernel @visit() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}

// The host's record of activity is out of date after the launch.
// CHECK-LABEL: llvm.func @write.entry(
//  CHECK-SAME:     %[[FRAME:.+]]: !llvm.ptr) -> i32
//       CHECK:   gpu.launch_func @kernels::@write_0
//       CHECK:   %[[REMOVES:.+]] = arith.constant 0 : i32
//       CHECK:   llvm.call @tai_rt_device_activates(%[[FRAME]], %{{.+}}, %[[REMOVES]])
tai.kernel @write() {
  %zero = arith.constant 0 : index
  %n = arith.constant 32 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) = (%zero) to (%n) {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}

// CHECK-LABEL: llvm.func @before(
//       CHECK:   gpu.launch_func @kernels::@before_0
//       CHECK:   %[[REMOVES:.+]] = arith.constant 1 : i32
//       CHECK:   llvm.call @tai_rt_device_activates(%{{.+}}, %{{.+}}, %[[REMOVES]])
//       CHECK:   llvm.call @tai_rt_active_cells
//       CHECK:   gpu.launch_func @kernels::@before_1
tai.kernel @before() {
  %c = arith.constant 8 : index
  tai.deactivate @x[%c] level 2
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}

// -----

// A list that is asked for inside of a loop is made before it; not where the
// loop changes it.
tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: f32, n: i64}>>>
tai.field @n = @t["n"] : i64, rank 1

// CHECK-LABEL: llvm.func @inside(
//       CHECK:   llvm.call @tai_rt_active_cells
//       CHECK:   llvm.call @tai_rt_list_is_current
//       CHECK:   gpu.launch_func @kernels::@inside_0
tai.kernel @inside() {
  %zero = arith.constant 0 : index
  %count = arith.constant 3 : index
  %base = tai_rt.tree_base @t : !llvm.ptr
  tai.parallel_for (%i) = (%zero) to (%count) {
    %cells, %k = tai_rt.active_cells %base, 0 : !llvm.ptr
    %all = tai_rt.list_is_current %base, 0 : !llvm.ptr
    scf.if %all {
      %number = arith.index_cast %k : index to i64
      llvm.store %number, %base : i64, !llvm.ptr
    }
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<pointer<[i: 4], dense<[i: 8], {x: f32, n: i64}>>>

tai.kernel @changes() {
  %zero = arith.constant 0 : index
  %count = arith.constant 3 : index
  %base = tai_rt.tree_base @t : !llvm.ptr
  tai.parallel_for (%i) = (%zero) to (%count) {
    // expected-error@+1 {{the list of active cells, inside of a parallel loop that changes which are active, does not come to the GPU yet; make the loop over them a kernel of its own}}
    %cells, %k = tai_rt.active_cells %base, 0 : !llvm.ptr
    %number = arith.index_cast %k : index to i64
    llvm.store %number, %base : i64, !llvm.ptr
    tai_rt.deactivate_cell %base, 0, %i : !llvm.ptr
  }
  tai.return
}
