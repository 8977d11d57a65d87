// RUN: tai-opt %s --tai-autodiff --split-input-file --verify-diagnostics | FileCheck %s

// The indices of the loop are the digits of the place: no two iterations store
// to one element. The first digit may be of any size.
// CHECK-LABEL: func.func @digits_grad(
//       CHECK:   scf.parallel
func.func @digits(%x: memref<?xf64>, %y: memref<?xf64>, %n: index, %k: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  %c6 = arith.constant 6 : index
  scf.parallel (%a, %b, %c) = (%c0, %c0, %c0) to (%n, %c6, %c2) step (%c1, %c2, %c1) {
    %0 = arith.muli %a, %c6 : index
    %1 = arith.addi %0, %b : index
    %2 = arith.addi %1, %c : index
    %3 = arith.addi %2, %k : index
    %4 = memref.load %x[%3] : memref<?xf64>
    %5 = arith.mulf %4, %4 : f64
    memref.store %5, %y[%3] : memref<?xf64>
  }
  return
}

// -----

// A digit exceeds the factor of the next one: two iterations meet.
func.func @overlap(%x: memref<?xf64>, %y: memref<?xf64>, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  // expected-note @+1 {{have no order}}
  scf.parallel (%a, %b) = (%c0, %c0) to (%n, %c5) step (%c1, %c1) {
    %0 = arith.muli %a, %c4 : index
    %1 = arith.addi %0, %b : index
    %2 = memref.load %x[%1] : memref<?xf64>
    %3 = arith.mulf %2, %2 : f64
    // expected-error @+2 {{may store to the same element here}}
    // expected-note @+1 {{store to an element for each iteration}}
    memref.store %3, %y[%1] : memref<?xf64>
  }
  return
}

// -----

// Two digits of any size, with one factor.
func.func @equal(%x: memref<?xf64>, %y: memref<?xf64>, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  // expected-note @+1 {{have no order}}
  scf.parallel (%a, %b) = (%c0, %c0) to (%n, %n) step (%c1, %c1) {
    %0 = arith.addi %a, %b : index
    %1 = memref.load %x[%0] : memref<?xf64>
    %2 = arith.mulf %1, %1 : f64
    // expected-error @+2 {{may store to the same element here}}
    // expected-note @+1 {{store to an element for each iteration}}
    memref.store %2, %y[%0] : memref<?xf64>
  }
  return
}

// -----

// Blocks of a size that is not known, as a launch has them: i * n + j, j < n.
// CHECK-LABEL: func.func @blocks_grad(
//       CHECK:   scf.parallel
func.func @blocks(%x: memref<?xf64>, %y: memref<?xf64>, %m: index, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.parallel (%a, %b) = (%c0, %c0) to (%m, %n) step (%c1, %c1) {
    %0 = arith.muli %a, %n : index
    %1 = arith.addi %0, %b : index
    %2 = memref.load %x[%1] : memref<?xf64>
    %3 = arith.mulf %2, %2 : f64
    memref.store %3, %y[%1] : memref<?xf64>
  }
  return
}

// -----

// Two places, each with a block and a thread.
// CHECK-LABEL: func.func @blocks_2d_grad(
//       CHECK:   scf.parallel
func.func @blocks_2d(%x: memref<?x?xf64>, %y: memref<?x?xf64>, %m: index, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  scf.parallel (%a, %b, %c, %d) = (%c0, %c0, %c0, %c0) to (%m, %m, %c8, %n) step (%c1, %c1, %c1, %c1) {
    %0 = arith.muli %a, %c8 : index
    %1 = arith.addi %0, %c : index
    %2 = arith.muli %n, %b : index
    %3 = arith.addi %2, %d : index
    %4 = memref.load %x[%1, %3] : memref<?x?xf64>
    %5 = arith.mulf %4, %4 : f64
    memref.store %5, %y[%1, %3] : memref<?x?xf64>
  }
  return
}

// -----

// The thread counts further than the size of a block.
func.func @other_size(%x: memref<?xf64>, %y: memref<?xf64>, %m: index, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  // expected-note @+1 {{have no order}}
  scf.parallel (%a, %b) = (%c0, %c0) to (%n, %m) step (%c1, %c1) {
    %0 = arith.muli %a, %n : index
    %1 = arith.addi %0, %b : index
    %2 = memref.load %x[%1] : memref<?xf64>
    %3 = arith.mulf %2, %2 : f64
    // expected-error @+2 {{may store to the same element here}}
    // expected-note @+1 {{store to an element for each iteration}}
    memref.store %3, %y[%1] : memref<?xf64>
  }
  return
}

// -----

// One place has the digits of two indices, and none has the third.
func.func @third(%x: memref<?x?xf64>, %y: memref<?x?xf64>, %m: index, %n: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  // expected-note @+1 {{have no order}}
  scf.parallel (%a, %b, %c) = (%c0, %c0, %c0) to (%m, %n, %n) step (%c1, %c1, %c1) {
    %0 = arith.muli %a, %n : index
    %1 = arith.addi %0, %b : index
    %2 = memref.load %x[%1, %c] : memref<?x?xf64>
    %3 = arith.mulf %2, %2 : f64
    // expected-error @+2 {{may store to the same element here}}
    // expected-note @+1 {{store to an element for each iteration}}
    memref.store %3, %y[%1, %c0] : memref<?x?xf64>
  }
  return
}
