// RUN: tai-opt %s --tai-check-bounds=bounds=check --cse | FileCheck %s --check-prefix=CHECK
// RUN: tai-opt %s --tai-check-bounds=bounds=clamp --cse | FileCheck %s --check-prefix=CLAMP
// RUN: tai-opt %s --tai-check-bounds=bounds=clamp --tai-check-bounds=bounds=clamp --cse | FileCheck %s --check-prefix=CLAMP
// RUN: not tai-opt %s --tai-check-bounds=bounds=on 2>&1 | FileCheck %s --check-prefix=WRONG

// WRONG: Cannot find option named 'on'

tai.tree @t : !tai.root<dense<[i: 8], {x: f32, k: i32, v: vector<3xf32>}>>
tai.field @x = @t["x"] : f32, rank 1, offset [2]
tai.field @k = @t["k"] : i32, rank 1
tai.field @v = @t["v"] : vector<3xf32>, rank 1

// Indices that the launch decides and ones that data decide, in one kernel.
// CHECK-LABEL: tai.kernel @mixed(
//  CHECK-SAME:     attributes {checks_indices}
//       CHECK:   tai.precondition
//       CHECK:   tai.load @k[%{{.+}}] {tai.in_range} : i32
//       CHECK:   tai.load @x[%{{.+}}] : f32
//       CHECK:   tai.store %{{.+}}, @x[%{{.+}}] {tai.in_range} : f32
// CLAMP-LABEL: tai.kernel @mixed(
//   CLAMP-NOT:   tai.precondition
//       CLAMP:   %[[K:.+]] = tai.load @k[%[[I:.+]]] : i32
//       CLAMP:   %[[AT:.+]] = arith.index_cast %[[K]]
//   CLAMP-DAG:   %[[LAST:.+]] = arith.constant 9 : index
//       CLAMP:   %[[BELOW:.+]] = arith.minsi %[[AT]], %[[LAST]]
//       CLAMP:   %[[IN:.+]] = arith.maxsi %[[BELOW]], %{{.+}}
//       CLAMP:   tai.load @x[%[[IN]]]
//   CLAMP-NOT:   arith.minsi
//       CLAMP:   tai.return
tai.kernel @mixed(%n: i32) {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %to = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%c0) to (%to) {
    %k = tai.load @k[%i] : i32
    %at = arith.index_cast %k : i32 to index
    %x = tai.load @x[%at] : f32
    %j = arith.addi %i, %c2 : index
    tai.store %x, @x[%j] : f32
  }
  tai.return
}

// Conditions on data keep an index in range, too; and so does its type.
// CHECK-LABEL: tai.kernel @asked(
//   CHECK-NOT:   checks_indices
//       CHECK:   tai.store %{{.+}}, @x[%{{.+}}] {tai.in_range}
//       CHECK:   tai.store %{{.+}}, @v[%{{.+}}] component[%{{.+}}] {tai.in_range}
// CLAMP-LABEL: tai.kernel @asked(
//   CLAMP-NOT:   arith.minsi
//       CLAMP:   tai.return
tai.kernel @asked(%one: f32) {
  %c2 = arith.constant 2 : i32
  %c10 = arith.constant 10 : i32
  %three = arith.constant 3 : i32
  tai.parallel_for (%i) in @k {
    %k = tai.load @k[%i] : i32
    %low = arith.cmpi sge, %k, %c2 : i32
    %high = arith.cmpi slt, %k, %c10 : i32
    %in = arith.andi %low, %high : i1
    scf.if %in {
      %at = arith.index_cast %k : i32 to index
      tai.store %one, @x[%at] : f32
    }
    %r = arith.remui %k, %three : i32
    %c = arith.index_cast %r : i32 to index
    tai.store %one, @v[%i] component [%c] : f32
  }
  tai.return
}

// In the loop over the field all is known: the kernel is compiled as without
// checks.
// CHECK-LABEL: tai.kernel @free(
//   CHECK-NOT:   checks_indices
//       CHECK:   tai.store %{{.+}}, @x[%{{.+}}] {tai.in_range}
tai.kernel @free(%one: f32) {
  tai.parallel_for (%i) in @x {
    tai.store %one, @x[%i] : f32
  }
  tai.return
}

// An i32 sum that may wrap around is refused where it does not, and is checked
// as it runs because it may.
// CHECK-LABEL: tai.kernel @wraps(
//  CHECK-SAME:     attributes {checks_indices}
//       CHECK:   tai.precondition
tai.kernel @wraps(%by: i32, %one: f32) {
  tai.parallel_for (%i) in @k {
    %w = arith.index_cast %i : index to i32
    %s = arith.addi %w, %by : i32
    %at = arith.index_cast %s : i32 to index
    tai.store %one, @x[%at] : f32
  }
  tai.return
}

// Arrays: the last index is known to the launch.
// CLAMP-LABEL: tai.kernel @array(
//  CLAMP-SAME:     %[[A:[^:]+]]: memref<?xf32>
//       CLAMP:   %[[N:.+]] = memref.dim %[[A]]
//       CLAMP:   %[[LAST:.+]] = arith.subi %[[N]]
//       CLAMP:   arith.minsi %{{.+}}, %[[LAST]]
tai.kernel @array(%a: memref<?xf32>, %one: f32) {
  tai.parallel_for (%i) in @k {
    %k = tai.load @k[%i] : i32
    %at = arith.index_cast %k : i32 to index
    memref.store %one, %a[%at] : memref<?xf32>
  }
  tai.return
}

// The cells of lists: the index along which a list grows is none of them, and
// the other one ends at 2.
tai.tree @lists : !tai.root<dense<[j: 3], dynamic<[i: 16], chunk 4, {e: f32}>>>
tai.field @e = @lists["e"] : f32, rank 2
// CLAMP-LABEL: tai.kernel @lists_of_cells(
//       CLAMP:   %[[TWO:.+]] = arith.constant 2 : index
//       CLAMP:   %[[LEAST:.+]] = arith.minsi %{{.+}}, %[[TWO]]
//       CLAMP:   %[[AT:.+]] = arith.maxsi %[[LEAST]], %{{.+}}
//       CLAMP:   tai.append %{{.+}}, @e[%[[AT]]]
//       CLAMP:   tai.length @e[%{{.+}}]
tai.kernel @lists_of_cells(%one: f32) {
  tai.parallel_for (%i) in @k {
    %k = tai.load @k[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.append %one, @e[%j] : f32
    %1 = tai.length @e[%j]
    %2 = arith.index_cast %1 : index to i32
    tai.store %2, @k[%i] : i32
  }
  tai.return
}

// A loop that compares without a sign counts on to negative numbers: an upper
// limit is none from below.
// CHECK-LABEL: tai.kernel @unsigned_loop(
//  CHECK-SAME:     attributes {checks_indices}
//       CHECK:   tai.store %{{.+}}, @k[%{{.+}}] : i32
// CHECK-LABEL: tai.kernel @signed_loop(
//   CHECK-NOT:     checks_indices
//       CHECK:   tai.store %{{.+}}, @k[%{{.+}}] {tai.in_range} : i32
tai.kernel @unsigned_loop() {
  %c0 = arith.constant 0 : i32
  %c2 = arith.constant 2 : i32
  %c8 = arith.constant 8 : i32
  %most = arith.constant -1 : i32
  scf.for unsigned %j = %c0 to %most step %c2 : i32 {
    %if = arith.cmpi slt, %j, %c8 : i32
    scf.if %if {
      %at = arith.index_cast %j : i32 to index
      tai.store %c2, @k[%at] : i32
    }
  }
  tai.return
}
tai.kernel @signed_loop() {
  %c0 = arith.constant 0 : i32
  %c2 = arith.constant 2 : i32
  %c8 = arith.constant 8 : i32
  %most = arith.constant 100 : i32
  scf.for %j = %c0 to %most step %c2 : i32 {
    %if = arith.cmpi slt, %j, %c8 : i32
    scf.if %if {
      %at = arith.index_cast %j : i32 to index
      tai.store %c2, @k[%at] : i32
    }
  }
  tai.return
}
