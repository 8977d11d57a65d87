// RUN: tai-opt %s --tai-autodiff --split-input-file -verify-diagnostics | FileCheck %s

// The copy of the array and the record of its reads fit.
// CHECK-LABEL: func.func @fits_grad(
//       CHECK:   memref.alloc() : memref<10xf64>
//       CHECK:   memref.alloc() : memref<50xf64>
// expected-warning @+2 {{'@fits_grad' runs '@fits' again}}
// expected-note @+1 {{this concerns the arguments at the positions 0}}
func.func @fits(%x: memref<10xf64>) attributes {tai.differentiate, tai.trace_bytes = 480 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  %c10 = arith.constant 10 : index
  scf.for %s = %c0 to %c5 step %c1 {
    scf.for %i = %c0 to %c10 step %c1 {
      %a = memref.load %x[%i] : memref<10xf64>
      %b = arith.mulf %a, %a : f64
      memref.store %b, %x[%i] : memref<10xf64>
    }
  }
  return
}

// -----

// expected-error @+1 {{cannot differentiate '@exceeds' within 'tai.trace_bytes' of 479: the copies and records of the derivative take 480 bytes}}
func.func @exceeds(%x: memref<10xf64>) attributes {tai.differentiate, tai.trace_bytes = 479 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c5 = arith.constant 5 : index
  %c10 = arith.constant 10 : index
  scf.for %s = %c0 to %c5 step %c1 {
    scf.for %i = %c0 to %c10 step %c1 {
      // expected-note @+1 {{the value read here is recorded, because it is overwritten; a store to another array keeps it}}
      %a = memref.load %x[%i] : memref<10xf64>
      %b = arith.mulf %a, %a : f64
      memref.store %b, %x[%i] : memref<10xf64>
    }
  }
  return
}

// -----

// expected-error @+1 {{cannot differentiate '@unknown' within 'tai.trace_bytes' of 1000: the size of a record depends on the arguments}}
func.func @unknown(%x: memref<10xf64>, %n: index) attributes {tai.differentiate, tai.trace_bytes = 1000 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %i = %c0 to %n step %c1 {
    // expected-note @+1 {{the value read here is recorded}}
    %a = memref.load %x[%i] : memref<10xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %x[%i] : memref<10xf64>
  }
  return
}

// -----

// A function that overwrites nothing records nothing.
// CHECK-LABEL: func.func @keeps_grad(
//   CHECK-NOT:   memref.alloc
func.func @keeps(%x: memref<10xf64>, %y: memref<10xf64>) attributes {tai.differentiate, tai.trace_bytes = 0 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c10 = arith.constant 10 : index
  scf.for %i = %c0 to %c10 step %c1 {
    %a = memref.load %x[%i] : memref<10xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %y[%i] : memref<10xf64>
  }
  return
}
