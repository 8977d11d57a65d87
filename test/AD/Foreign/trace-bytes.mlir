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

// The length of segments is found when the derivative runs: the longest that fits.
// CHECK-LABEL: func.func @unknown_grad(
//       CHECK:   scf.while
//       CHECK:     arith.cmpi sgt, %{{.+}}, %c920
//       CHECK:   cf.assert %{{.+}}, "the copies and records of the derivative of '@unknown' take more than 1000 bytes"
//       CHECK:   memref.alloc(%{{.+}}) : memref<?x10xf64>
//       CHECK:   memref.alloc(%{{.+}}) : memref<?xf64>
// expected-warning @+2 {{'@unknown_grad' runs '@unknown' again}}
// expected-note @+1 {{this concerns the arguments at the positions 0}}
func.func @unknown(%x: memref<10xf64>, %n: index) attributes {tai.differentiate, tai.trace_bytes = 1000 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %i = %c0 to %n step %c1 {
    %a = memref.load %x[%i] : memref<10xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %x[%i] : memref<10xf64>
  }
  return
}

// -----

// expected-error @+1 {{cannot differentiate '@counted' within 'tai.trace_bytes' of 1000: the size of a record depends on the arguments}}
func.func @counted(%x: memref<10xf64>, %limit: f64) attributes {tai.differentiate, tai.trace_bytes = 1000 : i64} {
  %c0 = arith.constant 0 : index
  scf.while : () -> () {
    // expected-note @+1 {{the value read here is recorded}}
    %a = memref.load %x[%c0] : memref<10xf64>
    %more = arith.cmpf olt, %a, %limit : f64
    scf.condition(%more)
  } do {
    // expected-note @+1 {{the value read here is recorded}}
    %a = memref.load %x[%c0] : memref<10xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %x[%c0] : memref<10xf64>
    scf.yield
  }
  return
}

// -----

// Values that a loop carries are counted: 100 take 800 bytes, and the gradient keeps 20 of them and 5 checkpoints.
// CHECK-LABEL: func.func @carried_grad(
//       CHECK:   memref.alloc() : memref<25xf64>
func.func @carried(%x: memref<2xf64>, %y: memref<2xf64>) attributes {tai.differentiate, tai.trace_bytes = 320 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  %a0 = memref.load %x[%c0] : memref<2xf64>
  %r = scf.for %s = %c0 to %c100 step %c1 iter_args(%a = %a0) -> f64 {
    %b = math.sin %a : f64
    scf.yield %b : f64
  }
  memref.store %r, %y[%c0] : memref<2xf64>
  return
}

// -----

// expected-error @+1 {{cannot differentiate '@carried_more' within 'tai.trace_bytes' of 100: the copies and records of the derivative take 160 bytes}}
func.func @carried_more(%x: memref<2xf64>, %y: memref<2xf64>) attributes {tai.differentiate, tai.trace_bytes = 100 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c100 = arith.constant 100 : index
  %a0 = memref.load %x[%c0] : memref<2xf64>
  %r = scf.for %s = %c0 to %c100 step %c1 iter_args(%a = %a0) -> f64 {
    %b = math.sin %a : f64
    scf.yield %b : f64
  }
  memref.store %r, %y[%c0] : memref<2xf64>
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

// -----

// 20 steps whose records take 1280 bytes, in 800 bytes: the array is kept at the start of each of 3 segments of at most 7
// steps, and each segment runs again with records of its own, from the last one to the first one.
// CHECK-LABEL: func.func @divided_grad(
//  CHECK-SAME:     %[[X:.+]]: memref<10xf64>, %[[DX:.+]]: memref<10xf64>)
//       CHECK:   %[[COPY:.+]] = memref.alloc() : memref<10xf64>
//  CHECK-NEXT:   memref.copy %[[X]], %[[COPY]]
//       CHECK:   %[[TRACE:.+]] = memref.alloc() : memref<56xf64>
//  CHECK-NEXT:   %[[KEPT:.+]] = memref.alloc() : memref<3x10xf64>
//  CHECK-NEXT:   scf.for
//  CHECK-NEXT:     scf.for
//  CHECK-NEXT:       memref.load %[[COPY]]
//  CHECK-NEXT:       memref.store %{{.+}}, %[[KEPT]]
//   CHECK-NOT:     memref.store %{{.+}}, %[[TRACE]]
//       CHECK:     %[[LAST:.+]] = arith.subi
//  CHECK-NEXT:     scf.for
//  CHECK-NEXT:       memref.load %[[KEPT]][%[[LAST]]
//  CHECK-NEXT:       memref.store %{{.+}}, %[[COPY]]
//       CHECK:     memref.store %{{.+}}, %[[TRACE]]
//       CHECK:     memref.load %[[TRACE]]
//       CHECK:   memref.dealloc %[[COPY]]
//       CHECK:   memref.dealloc %[[KEPT]]
// expected-warning @+2 {{'@divided_grad' runs '@divided' again}}
// expected-note @+1 {{this concerns the arguments at the positions 0}}
func.func @divided(%x: memref<10xf64>) attributes {tai.differentiate, tai.trace_bytes = 800 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %c20 = arith.constant 20 : index
  scf.for %s = %c0 to %c20 step %c1 {
    scf.for %i = %c0 to %c8 step %c1 {
      %a = memref.load %x[%i] : memref<10xf64>
      %b = arith.mulf %a, %a : f64
      memref.store %b, %x[%i] : memref<10xf64>
    }
  }
  return
}

// -----

// No segments, since an array that the loop reads changes after the loop.
// expected-error @+1 {{cannot differentiate '@changed' within 'tai.trace_bytes' of 1000}}
func.func @changed(%x: memref<10xf64>) attributes {tai.differentiate, tai.trace_bytes = 1000 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %c20 = arith.constant 20 : index
  %w = memref.alloc() : memref<10xf64>
  scf.for %i = %c0 to %c8 step %c1 {
    %a = memref.load %x[%i] : memref<10xf64>
    memref.store %a, %w[%i] : memref<10xf64>
  }
  scf.for %s = %c0 to %c20 step %c1 {
    scf.for %i = %c0 to %c8 step %c1 {
      // expected-note @+1 {{the value read here is recorded}}
      %a = memref.load %x[%i] : memref<10xf64>
      // expected-note @+1 {{the value read here is recorded}}
      %v = memref.load %w[%i] : memref<10xf64>
      %b = arith.mulf %a, %v : f64
      memref.store %b, %x[%i] : memref<10xf64>
    }
  }
  scf.for %i = %c0 to %c8 step %c1 {
    %a = memref.load %x[%i] : memref<10xf64>
    memref.store %a, %w[%i] : memref<10xf64>
  }
  scf.for %i = %c0 to %c8 step %c1 {
    // expected-note @+1 {{the value read here is recorded}}
    %a = memref.load %w[%i] : memref<10xf64>
    %b = arith.mulf %a, %a : f64
    memref.store %b, %x[%i] : memref<10xf64>
  }
  memref.dealloc %w : memref<10xf64>
  return
}

// -----

// An iteration has too many records: it is a segment, and its inner loop is divided.
// CHECK-LABEL: func.func @inner_grad(
//       CHECK:   memref.alloc() : memref<60xf64>
//       CHECK:   memref.alloc() : memref<3x4xf64>
//       CHECK:   memref.alloc() : memref<2x4xf64>
// expected-warning @+2 {{'@inner_grad' runs '@inner' again}}
// expected-note @+1 {{this concerns the arguments at the positions 0}}
func.func @inner(%x: memref<4xf64>) attributes {tai.differentiate, tai.trace_bytes = 700 : i64} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c30 = arith.constant 30 : index
  scf.for %s = %c0 to %c3 step %c1 {
    scf.for %t = %c0 to %c30 step %c1 {
      scf.for %i = %c0 to %c4 step %c1 {
        %a = memref.load %x[%i] : memref<4xf64>
        %b = arith.mulf %a, %a : f64
        memref.store %b, %x[%i] : memref<4xf64>
      }
    }
  }
  return
}
