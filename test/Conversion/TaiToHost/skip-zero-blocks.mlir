// RUN: tai-opt %s --tai-skip-zero-blocks --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-skip-zero-blocks=min-nanoseconds=1000 --split-input-file | FileCheck %s --check-prefix=CHEAP

// CHEAP-NOT: tai_rt_count_cells
// CHEAP-NOT: tai.adjoint_access

#group = #llvm.access_group<id = distinct[0]<>>
#loop = #llvm.loop_annotation<parallelAccesses = #group>

// A block runs if an adjoint is not zero or a factor is huge. The first
// iteration is tested alone.
// CHECK-LABEL: llvm.func @product(
//   CHECK-DAG:   %[[SIZE:.+]] = arith.constant 128 : index
//       CHECK:   scf.for %[[B:.+]] = %{{.+}} to %[[HI:.+]] step %[[SIZE]] {
//       CHECK:     %[[NEXT:.+]] = arith.addi %[[B]], %[[SIZE]]
//       CHECK:     %[[END:.+]] = arith.minsi %[[NEXT]], %[[HI]]
//       CHECK:     %[[X:.+]] = llvm.load
//       CHECK:     %[[G:.+]] = llvm.load
//       CHECK:     %[[BITS:.+]] = arith.bitcast %[[G]] : f32 to i32
//       CHECK:     %[[ADJOINT:.+]] = arith.cmpi ne, %[[BITS]]
//       CHECK:     arith.bitcast %[[X]]
//       CHECK:     %[[HUGE:.+]] = arith.cmpi sgt
//       CHECK:     %[[FIRST:.+]] = arith.ori %[[ADJOINT]], %[[HUGE]]
//       CHECK:     %[[ANY:.+]] = scf.if %[[FIRST]] -> (i1) {
//       CHECK:     } else {
//       CHECK:       scf.for %{{.+}} = %[[B]] to %[[END]] {{.*}} iter_args
//       CHECK:     scf.if %[[ANY]] {
//       CHECK:       scf.for %{{.+}} = %[[B]] to %[[END]]
//       CHECK:         math.cos
//       CHECK:         llvm.store
//       CHECK:     } else {
//   CHECK-NOT:       math.cos
//       CHECK:   llvm.call @tai_rt_count_cells(%arg0,
llvm.func @product(%frame: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  %lo = arith.constant 0 : index
  %hi = arith.constant 1000 : index
  %x, %gx, %gy = builtin.unrealized_conversion_cast %frame : !llvm.ptr to !llvm.ptr, !llvm.ptr, !llvm.ptr
  scf.for %i = %lo to %hi step %c1 {
    %k = arith.index_cast %i : index to i64
    %px = llvm.getelementptr %x[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %px {access_groups = [#group]} : !llvm.ptr -> f32
    %c = math.cos %v : f32
    %py = llvm.getelementptr %gy[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %g = llvm.load %py {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %a = arith.mulf %g, %c : f32
    %pg = llvm.getelementptr %gx[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %old = llvm.load %pg {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %sum = arith.addf %old, %a : f32
    llvm.store %sum, %pg {access_groups = [#group], tai.adjoint_access} : f32, !llvm.ptr
  } {llvm.loop_annotation = #loop}
  llvm.return
}

// A guard keeps an infinite factor out, so that it is not tested.
// CHECK-LABEL: llvm.func @guard(
//   CHECK-NOT:   arith.cmpi sgt
//       CHECK:   scf.if
//       CHECK:     scf.for
//       CHECK:       math.rsqrt
llvm.func @guard(%frame: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  %lo = arith.constant 0 : index
  %hi = arith.constant 1000 : index
  %x, %gx, %gy = builtin.unrealized_conversion_cast %frame : !llvm.ptr to !llvm.ptr, !llvm.ptr, !llvm.ptr
  %zero = arith.constant 0.0 : f32
  scf.for %i = %lo to %hi step %c1 {
    %k = arith.index_cast %i : index to i64
    %px = llvm.getelementptr %x[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %px {access_groups = [#group]} : !llvm.ptr -> f32
    %s = math.sin %v : f32
    %c = math.rsqrt %s : f32
    %py = llvm.getelementptr %gy[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %g = llvm.load %py {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %p = arith.mulf %g, %c : f32
    %t = arith.cmpf oeq, %g, %zero : f32
    %a = arith.select %t, %zero, %p : f32
    %pg = llvm.getelementptr %gx[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %old = llvm.load %pg {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %sum = arith.addf %old, %a : f32
    llvm.store %sum, %pg {access_groups = [#group], tai.adjoint_access} : f32, !llvm.ptr
  } {llvm.loop_annotation = #loop}
  llvm.return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#loop = #llvm.loop_annotation<parallelAccesses = #group>

// Without a guard, an infinite factor counts. CHECK is that nothing changes.
// CHECK-LABEL: llvm.func @infinite(
//   CHECK-NOT:   scf.if
//   CHECK-NOT:   tai.adjoint_access
llvm.func @infinite(%frame: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  %lo = arith.constant 0 : index
  %hi = arith.constant 1000 : index
  %x, %gx, %gy = builtin.unrealized_conversion_cast %frame : !llvm.ptr to !llvm.ptr, !llvm.ptr, !llvm.ptr
  scf.for %i = %lo to %hi step %c1 {
    %k = arith.index_cast %i : index to i64
    %px = llvm.getelementptr %x[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %px {access_groups = [#group]} : !llvm.ptr -> f32
    %s = math.sin %v : f32
    %c = math.rsqrt %s : f32
    %py = llvm.getelementptr %gy[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %g = llvm.load %py {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %a = arith.mulf %g, %c : f32
    %pg = llvm.getelementptr %gx[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %old = llvm.load %pg {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %sum = arith.addf %old, %a : f32
    llvm.store %sum, %pg {access_groups = [#group], tai.adjoint_access} : f32, !llvm.ptr
  } {llvm.loop_annotation = #loop}
  llvm.return
}

// A store that replaces is an effect, too.
// CHECK-LABEL: llvm.func @replaces(
//   CHECK-NOT:   scf.if
//       CHECK:   llvm.return
llvm.func @replaces(%frame: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  %lo = arith.constant 0 : index
  %hi = arith.constant 1000 : index
  %x, %gx, %gy = builtin.unrealized_conversion_cast %frame : !llvm.ptr to !llvm.ptr, !llvm.ptr, !llvm.ptr
  scf.for %i = %lo to %hi step %c1 {
    %k = arith.index_cast %i : index to i64
    %px = llvm.getelementptr %x[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %px {access_groups = [#group]} : !llvm.ptr -> f32
    %c = math.cos %v : f32
    %py = llvm.getelementptr %gy[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %g = llvm.load %py {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %a = arith.mulf %g, %c : f32
    %pg = llvm.getelementptr %gx[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    llvm.store %a, %pg {access_groups = [#group], tai.adjoint_access} : f32, !llvm.ptr
  } {llvm.loop_annotation = #loop}
  llvm.return
}

// An addition that other iterations may see ends the analysis; and so does a
// loop that is not marked as parallel.
// CHECK-LABEL: llvm.func @scatters(
//   CHECK-NOT:   scf.if
//       CHECK:   llvm.return
llvm.func @scatters(%frame: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  %lo = arith.constant 0 : index
  %hi = arith.constant 1000 : index
  %x, %gx, %gy = builtin.unrealized_conversion_cast %frame : !llvm.ptr to !llvm.ptr, !llvm.ptr, !llvm.ptr
  scf.for %i = %lo to %hi step %c1 {
    %k = arith.index_cast %i : index to i64
    %px = llvm.getelementptr %x[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %px {access_groups = [#group]} : !llvm.ptr -> f32
    %c = math.cos %v : f32
    %py = llvm.getelementptr %gy[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %g = llvm.load %py {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %a = arith.mulf %g, %c : f32
    %0 = llvm.atomicrmw fadd %gx, %a monotonic {tai.adjoint_access} : !llvm.ptr, f32
  } {llvm.loop_annotation = #loop}
  scf.for %i = %lo to %hi step %c1 {
    %k = arith.index_cast %i : index to i64
    %px = llvm.getelementptr %x[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %px : !llvm.ptr -> f32
    %c = math.cos %v : f32
    %py = llvm.getelementptr %gy[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %g = llvm.load %py {tai.adjoint_access} : !llvm.ptr -> f32
    %a = arith.mulf %g, %c : f32
    %old = llvm.load %gx {tai.adjoint_access} : !llvm.ptr -> f32
    %sum = arith.addf %old, %a : f32
    llvm.store %sum, %gx {tai.adjoint_access} : f32, !llvm.ptr
  }
  llvm.return
}

// -----

#group = #llvm.access_group<id = distinct[0]<>>
#loop = #llvm.loop_annotation<parallelAccesses = #group>

// An adjoint that counts as zero, whatever its memory holds, is set to zero for the
// iterations of a block that is skipped. The address may be computed twice.
// CHECK-LABEL: llvm.func @starts_at_zero(
//       CHECK:   %[[KNOWN:.+]] = arith.cmpi ne
//       CHECK:   scf.for %[[B:.+]] =
//       CHECK:     scf.if %{{.+}} {
//       CHECK:       math.cos
//       CHECK:     } else {
//       CHECK:       scf.if %[[KNOWN]] {
//       CHECK:         scf.for %[[I:.+]] = %[[B]] to
//       CHECK:           %[[K:.+]] = arith.index_cast %[[I]]
//       CHECK:           %[[AT:.+]] = llvm.getelementptr %{{.+}}[%[[K]]]
//       CHECK:           %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//       CHECK:           llvm.store %[[ZERO]], %[[AT]]
llvm.func @starts_at_zero(%frame: !llvm.ptr) attributes {passthrough = ["tai.lowered"]} {
  %c1 = arith.constant 1 : index
  %lo = arith.constant 0 : index
  %hi = arith.constant 1000 : index
  %none = arith.constant 0 : i64
  %zero = arith.constant 0.0 : f32
  %x, %gx, %gy = builtin.unrealized_conversion_cast %frame : !llvm.ptr to !llvm.ptr, !llvm.ptr, !llvm.ptr
  %bits = llvm.load %frame : !llvm.ptr -> i64
  %known = arith.cmpi ne, %bits, %none : i64
  scf.for %i = %lo to %hi step %c1 {
    %k = arith.index_cast %i : index to i64
    %px = llvm.getelementptr %x[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %v = llvm.load %px {access_groups = [#group]} : !llvm.ptr -> f32
    %c = math.cos %v : f32
    %py = llvm.getelementptr %gy[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %g = llvm.load %py {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %a = arith.mulf %g, %c : f32
    %pg = llvm.getelementptr %gx[%k] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    %old = llvm.load %pg {access_groups = [#group], tai.adjoint_access} : !llvm.ptr -> f32
    %start = arith.select %known, %zero, %old : f32
    %sum = arith.addf %start, %a : f32
    %again = arith.index_cast %i : index to i64
    %same = llvm.getelementptr %gx[%again] : (!llvm.ptr, i64) -> !llvm.ptr, f32
    llvm.store %sum, %same {access_groups = [#group], tai.adjoint_access} : f32, !llvm.ptr
  } {llvm.loop_annotation = #loop}
  llvm.return
}
