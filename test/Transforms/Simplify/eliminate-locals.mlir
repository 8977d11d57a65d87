// RUN: tai-opt %s --tai-eliminate-locals | FileCheck %s

// A load takes the value stored last; before the first store that is zero.
// CHECK-LABEL: func.func @straight(
//  CHECK-SAME:     %[[A:.+]]: f32)
//       CHECK:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//   CHECK-NOT:   tai.
//       CHECK:   return %[[ZERO]], %[[A]] : f32, f32
func.func @straight(%a: f32) -> (f32, f32) {
  %v = tai.alloca : !tai.local<f32>
  %before = tai.local_load %v : f32
  tai.local_store %a, %v : f32
  %after = tai.local_load %v : f32
  return %before, %after : f32, f32
}

// Only the variable that an arm writes leaves the branch as a result; an arm
// that does not write it passes on the old value.
// CHECK-LABEL: func.func @branch(
//  CHECK-SAME:     %[[C:.+]]: i1, %[[A:.+]]: f32, %[[B:.+]]: f32)
//       CHECK:   %[[R:.+]] = scf.if %[[C]] -> (f32) {
//       CHECK:     %[[SUM:.+]] = arith.addf %[[A]], %[[B]]
//       CHECK:     scf.yield %[[SUM]] : f32
//       CHECK:   } else {
//       CHECK:     scf.yield %[[A]] : f32
//       CHECK:   }
//       CHECK:   return %[[R]], %[[B]] : f32, f32
func.func @branch(%c: i1, %a: f32, %b: f32) -> (f32, f32) {
  %v = tai.alloca : !tai.local<f32>
  %w = tai.alloca : !tai.local<f32>
  tai.local_store %a, %v : f32
  tai.local_store %b, %w : f32
  scf.if %c {
    %0 = tai.local_load %v : f32
    %1 = tai.local_load %w : f32
    %2 = arith.addf %0, %1 : f32
    tai.local_store %2, %v : f32
  }
  %3 = tai.local_load %v : f32
  %4 = tai.local_load %w : f32
  return %3, %4 : f32, f32
}

// Results that a branch already has come first.
// CHECK-LABEL: func.func @branch_with_result(
//       CHECK:   %[[R:.+]]:2 = scf.if %{{.+}} -> (f32, vector<2xf32>) {
//       CHECK:     scf.yield %{{.+}}, %{{.+}} : f32, vector<2xf32>
//       CHECK:   } else {
//       CHECK:     scf.yield %{{.+}}, %{{.+}} : f32, vector<2xf32>
//       CHECK:   return %[[R]]#0, %[[R]]#1
func.func @branch_with_result(%c: i1, %a: f32, %p: vector<2xf32>)
    -> (f32, vector<2xf32>) {
  %v = tai.alloca : !tai.local<vector<2xf32>>
  %r = scf.if %c -> (f32) {
    tai.local_store %p, %v : vector<2xf32>
    scf.yield %a : f32
  } else {
    %n = arith.negf %a : f32
    scf.yield %n : f32
  }
  %0 = tai.local_load %v : vector<2xf32>
  return %r, %0 : f32, vector<2xf32>
}

// A variable that a loop writes is carried; also through a branch inside it.
// CHECK-LABEL: func.func @loop(
//  CHECK-SAME:     %[[N:.+]]: index, %[[C:.+]]: i1, %[[A:.+]]: f32)
//       CHECK:   %[[R:.+]] = scf.for %{{.+}} iter_args(%[[V:.+]] = %[[A]]) -> (f32) {
//       CHECK:     %[[NEXT:.+]] = scf.if %[[C]] -> (f32) {
//       CHECK:       %[[SQUARE:.+]] = arith.mulf %[[V]], %[[V]]
//       CHECK:       scf.yield %[[SQUARE]]
//       CHECK:     } else {
//       CHECK:       scf.yield %[[V]]
//       CHECK:     scf.yield %[[NEXT]]
//       CHECK:   return %[[R]]
func.func @loop(%n: index, %c: i1, %a: f32) -> f32 {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %v = tai.alloca : !tai.local<f32>
  tai.local_store %a, %v : f32
  scf.for %i = %c0 to %n step %c1 {
    scf.if %c {
      %0 = tai.local_load %v : f32
      %1 = arith.mulf %0, %0 : f32
      tai.local_store %1, %v : f32
    }
  }
  %r = tai.local_load %v : f32
  return %r : f32
}

// A variable of one iteration begins at zero in each, and is not carried.
// CHECK-LABEL: func.func @inner(
//   CHECK-NOT:   iter_args
//       CHECK:   scf.for
//       CHECK:     %[[ZERO:.+]] = arith.constant 0 : i32
//       CHECK:     memref.store %[[ZERO]]
func.func @inner(%n: index, %m: memref<?xi32>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %i = %c0 to %n step %c1 {
    %v = tai.alloca : !tai.local<i32>
    %0 = tai.local_load %v : i32
    memref.store %0, %m[%i] : memref<?xi32>
    %1 = arith.index_cast %i : index to i32
    tai.local_store %1, %v : i32
  }
  return
}

// Both regions of a while loop can write: x = 2x until x >= limit, counting.
// CHECK-LABEL: func.func @while(
//  CHECK-SAME:     %[[LIMIT:.+]]: f32, %[[A:.+]]: f32)
//       CHECK:   %[[R:.+]]:2 = scf.while (%[[X:.+]] = %[[A]], %[[K:.+]] = %{{.+}}) : (f32, i32) -> (f32, i32) {
//       CHECK:     %[[C:.+]] = arith.cmpf olt, %[[X]], %[[LIMIT]]
//       CHECK:     %[[K1:.+]] = arith.addi %[[K]], %{{.+}}
//       CHECK:     scf.condition(%[[C]]) %[[X]], %[[K1]] : f32, i32
//       CHECK:   } do {
//       CHECK:   ^bb0(%[[X1:.+]]: f32, %[[K2:.+]]: i32):
//       CHECK:     %[[X2:.+]] = arith.addf %[[X1]], %[[X1]]
//       CHECK:     scf.yield %[[X2]], %[[K2]] : f32, i32
//       CHECK:   return %[[R]]#0, %[[R]]#1
func.func @while(%limit: f32, %a: f32) -> (f32, i32) {
  %one = arith.constant 1 : i32
  %x = tai.alloca : !tai.local<f32>
  %k = tai.alloca : !tai.local<i32>
  tai.local_store %a, %x : f32
  scf.while : () -> () {
    %0 = tai.local_load %x : f32
    %c = arith.cmpf olt, %0, %limit : f32
    %1 = tai.local_load %k : i32
    %2 = arith.addi %1, %one : i32
    tai.local_store %2, %k : i32
    scf.condition(%c)
  } do {
    %3 = tai.local_load %x : f32
    %4 = arith.addf %3, %3 : f32
    tai.local_store %4, %x : f32
    scf.yield
  }
  %5 = tai.local_load %x : f32
  %6 = tai.local_load %k : i32
  return %5, %6 : f32, i32
}

// A variable of an iteration of a parallel loop is as any other.
// CHECK-LABEL: tai.kernel @parallel(
//   CHECK-NOT:   tai.alloca
//       CHECK:   tai.parallel_for
//       CHECK:     scf.for {{.+}} iter_args
tai.kernel @parallel(%n: index, %m: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %s = tai.alloca : !tai.local<f32>
    scf.for %j = %c0 to %i step %c1 {
      %0 = tai.local_load %s : f32
      %1 = memref.load %m[%j] : memref<?xf32>
      %2 = arith.addf %0, %1 : f32
      tai.local_store %2, %s : f32
    }
    %3 = tai.local_load %s : f32
    memref.store %3, %m[%i] : memref<?xf32>
  }
  tai.return
}
