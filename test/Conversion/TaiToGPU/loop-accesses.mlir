// RUN: tai-opt %s --tai-lower-struct-for --tai-relax-atomics=on-device=true --tai-lower-layout=on-device=true --convert-tai-to-gpu | FileCheck %s

// Accesses of device functions, in terms of their parameters: first whether
// iteration i is of thread i, the rank and the extents. Then of each access the
// kind (0 a read, 1 a write, 2 a sum), the parameter that it starts from, the
// offset, the window, the step, the size, the unit of a product in 32 bits; the
// strides; and the number of terms, each with parameter, bits and factor.

tai.tree @tree : !tai.root<dense<[i: 16, j: 10, k: 8], {x: f32}>, dense<[i: 10, j: 8], {a: f32, b: f64}>, {n: i32}>
tai.field @x = @tree["x"] : f32, rank 3
tai.field @a = @tree["a"] : f32, rank 2
tai.field @b = @tree["b"] : f64, rank 2
tai.field @n = @tree["n"] : i32, rank 0

// Rows by the lowered argument: parameters 0 and 2.
// CHECK-LABEL: llvm.func @rows_0(
//  CHECK-SAME:   tai.accesses = array<i64: 1, 2, 10, 8,
//  CHECK-SAME:   0, 1, 0, 4, 4, 4, 0, 32, 4, 1, 0, 64, 320,
//  CHECK-SAME:   1, 1, 0, 4, 4, 4, 0, 32, 4, 1, 2, 64, 320>
tai.kernel @rows(%t: i32) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c10 = arith.constant 10 : index
  %c1 = arith.constant 1 : i32
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c10, %c8) {
    %next = arith.addi %t, %c1 : i32
    %from = arith.index_cast %t : i32 to index
    %to = arith.index_cast %next : i32 to index
    %0 = tai.load @x[%from, %i, %j] : f32
    tai.store %0, @x[%to, %i, %j] : f32
  }
  tai.return
}

// A wrapped index is any of its dimension; one that was shifted is not. Both
// fields of a cell are interleaved: the steps say so.
// CHECK-LABEL: llvm.func @stencil_0(
//  CHECK-SAME:   tai.accesses = array<i64: 1, 2, 9, 8,
//  CHECK-SAME:   0, 0, 128, 4, 16, 4, 0, 128, 16, 0,
//  CHECK-SAME:   0, 0, 0, 1156, 16, 4, 0, 0, 16, 0,
//  CHECK-SAME:   1, 0, 8, 8, 16, 8, 0, 128, 16, 0>
tai.kernel @stencil() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  tai.parallel_for (%i, %j) = (%c0, %c0) to (%c9, %c8) {
    %next = arith.addi %i, %c1 : index
    %0 = tai.load @a[%next, %j] : f32
    %further = arith.addi %i, %c3 : index
    %wrapped = arith.remui %further, %c10 : index
    %1 = tai.load @a[%wrapped, %j] : f32
    %2 = arith.addf %0, %1 : f32
    %3 = arith.extf %2 : f32 to f64
    tai.store %3, @b[%i, %j] : f64
  }
  tai.return
}

// Serial loops inside widen the window of an iteration, and products of the
// program in 32 bits have a unit.
// CHECK-LABEL: llvm.func @columns_0(
//  CHECK-SAME:   tai.accesses = array<i64: 1, 1, 10,
//  CHECK-SAME:   0, 1, 0, 36, 32, 4, 320, 0, 1, 0, 32, 960>
tai.kernel @columns(%t: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c10 = arith.constant 10 : index
  %c3 = arith.constant 3 : i32
  tai.parallel_for (%i) = (%c0) to (%c10) {
    scf.for %k = %c0 to %c2 step %c1 {
      %slot = arith.muli %t, %c3 : i32
      %at = arith.index_cast %slot : i32 to index
      %0 = tai.load @x[%at, %k, %c0] : f32
    }
    tai.yield
  }
  tai.return
}

// A loop that prints has no list.
// CHECK-LABEL: llvm.func @says_0(
//   CHECK-NOT:   tai.accesses
//       CHECK:   llvm.return
tai.kernel @says() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%c8) {
    tai.print "{}"(%i) : index
  }
  tai.return
}

// A row at constant indices, of which the program makes one constant, and an
// element of it that only the bounds of the loop know: the row begins at
// 2 * 320 + 3 * 32, and its window is the row.
// CHECK-LABEL: llvm.func @fixed_row_0(
//  CHECK-SAME:   tai.accesses = array<i64: 1, 1, -1, 1, 2, 736, 32, 4, 4, 0, 0, 0>
tai.kernel @fixed_row(%first: index, %last: index) {
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%k) = (%first) to (%last) {
    tai.store %one, @x[%c2, %c3, %k] : f32
  }
  tai.return
}

// A product that is no digit leaves the first index unknown: any element.
// CHECK-LABEL: llvm.func @product_0(
//  CHECK-SAME:   tai.accesses = array<i64: 1, 1, -1, 1, 2, 96, 4832, 4, 4, 0, 0, 0>
tai.kernel @product(%first: index, %last: index) {
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%k) = (%first) to (%last) {
    %twice = arith.muli %k, %c2 : index
    tai.store %one, @x[%twice, %c3, %k] : f32
  }
  tai.return
}
