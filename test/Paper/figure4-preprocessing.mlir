// RUN: tai-opt %s --tai-eliminate-locals --canonicalize | FileCheck %s --check-prefix=LOCALS
// RUN: tai-opt %s --tai-eliminate-locals --tai-flatten-branches --canonicalize | FileCheck %s --check-prefix=BOTH

// Section 3.1, "Simple IR preprocessing before running the AD source code
// transform": a branch that writes a mutable variable.
//
//   int a = 0;
//   if (b > 0) { a = b; } else { a = 2b; }
//   a = a + 1;
//   return a;

// The variable becomes the result of the branch.
// LOCALS-LABEL: func.func @figure(
//  LOCALS-SAME:     %[[B:.+]]: i32) -> i32
//   LOCALS-NOT:   tai.{{alloca|local}}
//       LOCALS:   %[[C:.+]] = arith.cmpi sgt, %[[B]]
//       LOCALS:   %[[A:.+]] = scf.if %[[C]] -> (i32) {
//       LOCALS:     scf.yield %[[B]]
//       LOCALS:   } else {
//       LOCALS:     %[[TWICE:.+]] = arith.muli %[[B]], %{{.+}}
//       LOCALS:     scf.yield %[[TWICE]]
//       LOCALS:   %[[R:.+]] = arith.addi %[[A]], %{{.+}}
//       LOCALS:   return %[[R]]

// ssa1 = select(b > 0, b, 2b); ssa2 = ssa1 + 1; return ssa2
// BOTH-LABEL: func.func @figure(
//  BOTH-SAME:     %[[B:.+]]: i32) -> i32
//  BOTH-DAG:   %[[C1:.+]] = arith.constant 1 : i32
//  BOTH-DAG:   %[[C2:.+]] = arith.constant 2 : i32
//       BOTH:   %[[C:.+]] = arith.cmpi sgt, %[[B]]
//   BOTH-NOT:   scf.if
//       BOTH:   %[[TWICE:.+]] = arith.muli %[[B]], %[[C2]]
//       BOTH:   %[[SSA1:.+]] = arith.select %[[C]], %[[B]], %[[TWICE]]
//       BOTH:   %[[SSA2:.+]] = arith.addi %[[SSA1]], %[[C1]]
//       BOTH:   return %[[SSA2]]
func.func @figure(%b: i32) -> i32 attributes {passthrough = ["tai.lowered"]} {
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  %c2 = arith.constant 2 : i32
  %a = tai.alloca : !tai.local<i32>
  tai.local_store %c0, %a : i32
  %positive = arith.cmpi sgt, %b, %c0 : i32
  scf.if %positive {
    tai.local_store %b, %a : i32
  } else {
    %twice = arith.muli %c2, %b : i32
    tai.local_store %twice, %a : i32
  }
  %old = tai.local_load %a : i32
  %new = arith.addi %old, %c1 : i32
  tai.local_store %new, %a : i32
  %r = tai.local_load %a : i32
  return %r : i32
}
