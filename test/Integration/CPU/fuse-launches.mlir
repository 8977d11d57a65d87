// RUN: tai-run %s --no-cache --print-field=@x --print-field=@z --print-field=@total | FileCheck %s
// RUN: tai-run %s --no-cache --no-fuse-launches --print-field=@x --print-field=@z --print-field=@total | FileCheck %s
// RUN: tai-run %s --no-cache --deterministic --print-field=@x --print-field=@z --print-field=@total | FileCheck %s
// RUN: tai-run %s --no-cache --compile-profile 2>&1 | FileCheck %s --check-prefix=FUSED
// RUN: tai-run %s --no-cache --compile-profile --no-fuse-launches 2>&1 | FileCheck %s --check-prefix=SINGLE

// Kernels launched one after another have the results of single launches.

// FUSED: grow_double
// SINGLE-NOT: grow_double

tai.tree @tree : !tai.root<dense<[i: 3, j: 4], {x: f64}>, dense<[i: 4], {z: f64}>, {total: f64}>
tai.field @x = @tree["x"] : f64, rank 2
tai.field @z = @tree["z"] : f64, rank 1
tai.field @total = @tree["total"] : f64, rank 0

tai.kernel @grow(%t: i32) {
  %c0 = arith.constant 0 : index
  %c4 = arith.constant 4 : index
  %c1 = arith.constant 1 : i32
  %next = arith.addi %t, %c1 : i32
  %from = arith.index_cast %t : i32 to index
  %to = arith.index_cast %next : i32 to index
  tai.parallel_for (%i) = (%c0) to (%c4) {
    %0 = tai.load @x[%from, %i] : f64
    %1 = arith.index_cast %i : index to i32
    %2 = arith.sitofp %1 : i32 to f64
    %3 = arith.addf %0, %2 : f64
    tai.store %3, @x[%to, %i] : f64
  }
  tai.return
}
tai.kernel @double(%t: i32) {
  %at = arith.index_cast %t : i32 to index
  tai.parallel_for (%i) in @z {
    %0 = tai.load @x[%at, %i] : f64
    %1 = arith.addf %0, %0 : f64
    %2 = tai.load @z[%i] : f64
    %3 = arith.addf %1, %2 : f64
    tai.store %3, @z[%i] : f64
    %4 = tai.atomic add %3, @total[] : f64
  }
  tai.return
}
// The neighbours of the row before.
tai.kernel @mirror() {
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) in @z {
    %0 = arith.subi %c3, %i : index
    %1 = tai.load @z[%0] : f64
    tai.store %1, @x[%c2, %i] : f64
  }
  tai.return
}

//      CHECK: @x : 3x4xf64 =
// CHECK-NEXT: {{\[\[}}0, 0, 0, 0],
// CHECK-NEXT:  [0, 1, 2, 3],
// CHECK-NEXT:  [18, 12, 6, 0]]
// CHECK-NEXT: @z : 4xf64 = [0, 6, 12, 18]
// CHECK-NEXT: @total : f64 = 48
func.func @main() {
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  %c2 = arith.constant 2 : i32
  tai.launch @grow(%c0) : (i32) -> ()
  tai.launch @double(%c1) : (i32) -> ()
  tai.launch @grow(%c1) : (i32) -> ()
  tai.launch @double(%c2) : (i32) -> ()
  tai.launch @mirror() : () -> ()
  return
}
