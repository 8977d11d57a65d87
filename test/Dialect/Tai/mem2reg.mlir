// RUN: tai-opt %s --pass-pipeline='builtin.module(tai.kernel(mem2reg))' --split-input-file | FileCheck %s
// RUN: tai-opt %s --pass-pipeline='builtin.module(tai.kernel(sroa,mem2reg))' --split-input-file | FileCheck %s --check-prefix=SROA

// Upstream's pass turns a local into values; before the first store it is zero.
// CHECK-LABEL: tai.kernel @straight(
//  CHECK-SAME:     %[[A:.+]]: f32)
//   CHECK-NOT:   tai.alloca
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//       CHECK:   %[[SUM:.+]] = arith.addf %[[ZERO]], %[[A]]
//       CHECK:   tai.return %[[SUM]]
tai.kernel @straight(%a: f32) -> f32 {
  %s = tai.alloca : !tai.local<f32>
  %0 = tai.local_load %s : f32
  %1 = arith.addf %0, %a : f32
  tai.local_store %1, %s : f32
  %2 = tai.local_load %s : f32
  tai.return %2 : f32
}

// -----

// So are vectors and integers, in the body of a parallel loop too.
tai.tree @t : !tai.root<dense<[i: 4], {x: vector<2xf32>}>>
tai.field @x = @t["x"] : vector<2xf32>, rank 1
// CHECK-LABEL: tai.kernel @in_loop(
//   CHECK-NOT:   tai.alloca
//       CHECK:   %[[X:.+]] = tai.load @x
//       CHECK:   tai.store %[[X]], @x
tai.kernel @in_loop() {
  tai.parallel_for (%i) in @x {
    %s = tai.alloca : !tai.local<vector<2xf32>>
    %n = tai.alloca : !tai.local<i32>
    %c = arith.index_cast %i : index to i32
    tai.local_store %c, %n : i32
    %d = tai.local_load %n : i32
    %at = arith.index_cast %d : i32 to index
    %0 = tai.load @x[%at] : vector<2xf32>
    tai.local_store %0, %s : vector<2xf32>
    %1 = tai.local_load %s : vector<2xf32>
    tai.store %1, @x[%at] : vector<2xf32>
  }
  tai.return
}

// -----

// A local that a branch writes stays: tai-eliminate-locals follows it there.
// CHECK-LABEL: tai.kernel @branch(
//       CHECK:   %[[S:.+]] = tai.alloca
//       CHECK:   tai.local_store %{{.+}}, %[[S]]
tai.kernel @branch(%c: i1, %a: f32) -> f32 {
  %s = tai.alloca : !tai.local<f32>
  scf.if %c {
    tai.local_store %a, %s : f32
  }
  %0 = tai.local_load %s : f32
  tai.return %0 : f32
}

// -----

// A local that is used in another way stays.
// CHECK-LABEL: func.func @escapes(
//       CHECK:   tai.alloca
func.func private @take(!tai.local<f32>)
func.func @escapes() {
  %s = tai.alloca : !tai.local<f32>
  func.call @take(%s) : (!tai.local<f32>) -> ()
  return
}

// -----

// A local array is a memref.alloca, which upstream takes apart.
// SROA-LABEL: tai.kernel @array(
//  SROA-SAME:     %[[A:.+]]: f32, %[[B:.+]]: f32)
//   SROA-NOT:   memref.alloca
//       SROA:   %[[SUM:.+]] = arith.addf %[[A]], %[[B]]
//       SROA:   tai.return %[[SUM]]
tai.kernel @array(%a: f32, %b: f32) -> f32 {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %s = memref.alloca() : memref<2xf32>
  memref.store %a, %s[%c0] : memref<2xf32>
  memref.store %b, %s[%c1] : memref<2xf32>
  %0 = memref.load %s[%c0] : memref<2xf32>
  %1 = memref.load %s[%c1] : memref<2xf32>
  %2 = arith.addf %0, %1 : f32
  tai.return %2 : f32
}
