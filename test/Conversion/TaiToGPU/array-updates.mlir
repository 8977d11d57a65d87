// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics=on-device --tai-lower-layout --convert-tai-to-gpu | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 128], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

// An array may be another one, too: a read of it does not go past the caches of
// writes if the loop adds to an array. Fields are no arrays.
// CHECK-LABEL: llvm.func @update_0(
//       CHECK:   llvm.load %{{.+}} invariant {alias_scopes = [#[[X:.+]]]} : !llvm.ptr -> f32
//       CHECK:   llvm.load %{{[0-9]+}} {alias_scopes = [#[[$ARRAYS:.+]]], noalias_scopes = [#[[X]]]} : !llvm.ptr -> f32
//       CHECK:   llvm.atomicrmw fadd %{{.+}} monotonic {alias_scopes = [#[[$ARRAYS]]], noalias_scopes = [#[[X]]]}
tai.kernel @update(%a: memref<?xf32>, %b: memref<?xf32>) {
  %c7 = arith.constant 7 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = memref.load %a[%i] : memref<?xf32>
    %2 = arith.addf %0, %1 : f32
    %3 = arith.remui %i, %c7 : index
    %4 = memref.atomic_rmw addf %2, %b[%3] : (f32, memref<?xf32>) -> f32
  }
  tai.return
}

// Where nothing is written to arrays, it does.
// CHECK-LABEL: llvm.func @read_0(
//       CHECK:   llvm.load %{{.+}} invariant {{.*}}alias_scopes = [#[[$ARRAYS]]]
tai.kernel @read(%a: memref<?xf32>) {
  tai.parallel_for (%i) in @x {
    %0 = memref.load %a[%i] : memref<?xf32>
    tai.store %0, @x[%i] : f32
  }
  tai.return
}
