// RUN: tai-opt %s --tai-guard-divisions | FileCheck %s
// RUN: tai-opt %s --tai-guard-divisions=debug | FileCheck %s --check-prefix=DEBUG

tai.tree @t : !tai.root<dense<[i: 64], {x: i32, y: i32}>>
tai.field @x = @t["x"] : i32, rank 1, offset [1]
tai.field @y = @t["y"] : i32, rank 1

// Both a missing quotient and one that is too large.
// CHECK-LABEL: tai.kernel @any(
//  CHECK-SAME:     %[[A:.+]]: i32, %[[B:.+]]: i32)
//       CHECK:   %[[C0:.+]] = arith.constant 0 : i32
//       CHECK:   %[[ZERO:.+]] = arith.cmpi eq, %[[B]], %[[C0]]
//       CHECK:   %[[CM1:.+]] = arith.constant -1 : i32
//       CHECK:   %[[MINUS:.+]] = arith.cmpi eq, %[[B]], %[[CM1]]
//       CHECK:   %[[CMIN:.+]] = arith.constant -2147483648 : i32
//       CHECK:   %[[MIN:.+]] = arith.cmpi eq, %[[A]], %[[CMIN]]
//       CHECK:   %[[BOTH:.+]] = arith.andi %[[MINUS]], %[[MIN]]
//       CHECK:   %[[UNSAFE:.+]] = arith.ori %[[ZERO]], %[[BOTH]]
//       CHECK:   %[[C1:.+]] = arith.constant 1 : i32
//       CHECK:   %[[D:.+]] = arith.select %[[UNSAFE]], %[[C1]], %[[B]]
//       CHECK:   %[[Q:.+]] = arith.divsi %[[A]], %[[D]]
//       CHECK:   %[[R:.+]] = arith.select %[[ZERO]], %{{.+}}, %[[Q]]
//       CHECK:   return %[[R]]
// DEBUG-LABEL: tai.kernel @any(
//       DEBUG:   tai.assert %{{.+}}, "a whole number is divided by zero"
//       DEBUG:   tai.assert %{{.+}}, "the smallest i32 is divided by -1, and has no negative"
//       DEBUG:   arith.divsi
tai.kernel @any(%a: i32, %b: i32) -> i32 {
  %q = arith.divsi %a, %b : i32
  tai.return %q : i32
}

// A remainder by one is zero as it is.
// CHECK-LABEL: tai.kernel @rest(
//       CHECK:   arith.select
//       CHECK:   %[[R:.+]] = arith.remui
//   CHECK-NOT:   arith.select
//       CHECK:   return %[[R]]
tai.kernel @rest(%a: i64, %b: i64) -> i64 {
  %r = arith.remui %a, %b : i64
  tai.return %r : i64
}

// Vectors, and every other form.
// CHECK-LABEL: tai.kernel @forms(
//       CHECK:   arith.cmpi eq, %{{.+}}, %{{.+}} : vector<3xi8>
//       CHECK:   arith.floordivsi
//       CHECK:   arith.cmpi eq
//       CHECK:   arith.ceildivsi
//       CHECK:   arith.cmpi eq
//       CHECK:   arith.ceildivui
//       CHECK:   arith.cmpi eq
//       CHECK:   arith.divui
//       CHECK:   arith.cmpi eq
//       CHECK:   arith.remsi
// DEBUG-LABEL: tai.kernel @forms(
//       DEBUG:   vector.reduction <or>
//       DEBUG:   tai.assert
//       DEBUG:   arith.floordivsi
tai.kernel @forms(%v: vector<3xi8>, %a: i16, %b: i16) -> i16 {
  %0 = arith.floordivsi %v, %v : vector<3xi8>
  %1 = arith.ceildivsi %a, %b : i16
  %2 = arith.ceildivui %1, %b : i16
  %3 = arith.divui %2, %b : i16
  %4 = arith.remsi %3, %b : i16
  tai.return %4 : i16
}

// Divisors that are known not to be zero: constants, indices of loops, and what
// follows from them.
// CHECK-LABEL: tai.kernel @known(
//   CHECK-NOT:   arith.cmpi
//   CHECK-NOT:   arith.select
//       CHECK: tai.return
// DEBUG-LABEL: tai.kernel @known(
//   DEBUG-NOT:   tai.assert
//       DEBUG: tai.return
tai.kernel @known(%n: i32) {
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  %seven = arith.constant 7 : i32
  %0 = arith.divsi %n, %seven : i32
  %at = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) in @x {
    %1 = arith.remsi %at, %i : index
    scf.for %k = %c1 to %c7 step %c1 {
      %2 = arith.divsi %at, %k : index
      %3 = arith.addi %k, %i : index
      %4 = arith.floordivsi %at, %3 : index
      %5 = arith.maxsi %at, %c1 : index
      %6 = arith.divsi %4, %5 : index
      tai.store %0, @x[%6] : i32
    }
  }
  tai.return
}

// A loop over a field whose first index is zero.
// CHECK-LABEL: tai.kernel @unknown(
//       CHECK:   arith.cmpi eq
//       CHECK:   arith.remsi
tai.kernel @unknown(%n: i32) {
  %at = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) in @y {
    %1 = arith.remsi %at, %i : index
    %2 = arith.index_cast %1 : index to i32
    tai.store %2, @y[%i] : i32
  }
  tai.return
}

// By minus one.
// CHECK-LABEL: tai.kernel @negate(
//       CHECK:   arith.cmpi eq
//       CHECK:   arith.divsi
//   CHECK-NOT:   arith.select
//       CHECK:   tai.return
tai.kernel @negate(%n: i32) -> i32 {
  %c = arith.constant -1 : i32
  %0 = arith.divsi %n, %c : i32
  tai.return %0 : i32
}

// Functions of others are left alone; those of the host are not.
// CHECK-LABEL: func.func @other(
//   CHECK-NOT:   arith.cmpi
//       CHECK: func.func @main(
//       CHECK:   arith.cmpi
func.func @other(%a: i32, %b: i32) -> i32 {
  %0 = arith.divsi %a, %b : i32
  return %0 : i32
}
func.func @main(%a: i32, %b: i32) {
  %0 = arith.divsi %a, %b : i32
  tai.launch @negate(%0) : (i32) -> i32
  return
}
