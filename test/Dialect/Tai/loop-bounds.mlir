// RUN: tai-opt %s --int-range-optimizations --canonicalize | FileCheck %s
// RUN: tai-opt %s --arith-int-range-narrowing=int-bitwidths-supported=32 | FileCheck %s --check-prefix=NARROW

// Passes of MLIR that ask loops for the ranges of their indices.

!t = !tai.root<dense<[i: 16], {x: i32}>>
!o = !tai.root<dense<[i: 8], {y: i32}>>
tai.tree @t : !t
tai.tree @o : !o
tai.field @x = @t["x"] : i32, rank 1
tai.field @y = @o["y"] : i32, rank 1, offset [-4]

// CHECK-LABEL: tai.kernel @box
tai.kernel @box() {
  %c2 = arith.constant 2 : index
  %c10 = arith.constant 10 : index
  tai.parallel_for (%i) = (%c2) to (%c10) {
    %inside = arith.cmpi slt, %i, %c10 : index
    %low = arith.cmpi sge, %i, %c2 : index
    %both = arith.andi %inside, %low : i1
    // CHECK: %[[ONE:.+]] = arith.constant 1 : i32
    // CHECK: tai.store %[[ONE]], @x
    %one = arith.extui %both : i1 to i32
    tai.store %one, @x[%i] : i32
  }
  tai.return
}

// The elements of a field: 0 to 15, and with an offset -4 to 3.
// CHECK-LABEL: tai.kernel @elements
tai.kernel @elements() {
  %c16 = arith.constant 16 : index
  %low = arith.constant -4 : index
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %inside = arith.cmpi ult, %i, %c16 : index
    // CHECK: tai.parallel_for (%[[I:.+]]) in @x
    // CHECK-NEXT: tai.store %{{.+}}, @x[%[[I]]]
    %one = arith.extui %inside : i1 to i32
    tai.store %one, @x[%i] : i32
  }
  tai.parallel_for (%i) in @y {
    %first = arith.cmpi sge, %i, %low : index
    // Not known: half of them are negative.
    // CHECK: arith.cmpi sge
    %positive = arith.cmpi sge, %i, %zero : index
    %both = arith.andi %first, %positive : i1
    %v = arith.extui %both : i1 to i32
    tai.store %v, @y[%i] : i32
  }
  tai.return
}

// Bounds that are not known. Without any iteration, there would be no loop.
// CHECK-LABEL: tai.kernel @unknown
// NARROW-LABEL: tai.kernel @unknown
tai.kernel @unknown(%n: index) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i, %j) = (%c0, %n) to (%n, %c8) {
    // CHECK: arith.addi
    %k = arith.addi %i, %j : index
    %v = arith.index_cast %k : index to i32
    tai.store %v, @x[%i] : i32
  }
  tai.return
}
