// RUN: tai-opt %s --tai-forward-diff | FileCheck %s
// RUN: tai-opt %s --tai-forward-diff --tai-forward-diff | FileCheck %s

// A region that hands nothing on is extended, whatever op holds it.
// CHECK-LABEL: func.func @regions_fwd(
//  CHECK-SAME:     %[[X:.+]]: memref<4xf64>, %[[Y:.+]]: memref<4xf64>, %{{.+}}: index, %[[DX:.+]]: memref<4xf64>, %[[DY:.+]]: memref<4xf64>)
//       CHECK:   scf.execute_region {
//       CHECK:     %[[A:.+]] = memref.load %[[DX]]
//       CHECK:     memref.store %[[A]], %[[DY]]
//       CHECK:   scf.index_switch
//       CHECK:     %[[B:.+]] = memref.load %[[DX]]
//       CHECK:     memref.store %[[B]], %[[DY]]
func.func @regions(%x: memref<4xf64>, %y: memref<4xf64>, %k: index) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.execute_region {
    %0 = memref.load %x[%c0] : memref<4xf64>
    memref.store %0, %y[%c0] : memref<4xf64>
    scf.yield
  }
  scf.index_switch %k
  case 1 {
    %0 = memref.load %x[%c1] : memref<4xf64>
    memref.store %0, %y[%c1] : memref<4xf64>
    scf.yield
  }
  default {
    scf.yield
  }
  return
}

// Variables, stacks and arrays that hold constants get no second one.
// CHECK-LABEL: func.func @locals_fwd(
//       CHECK:   tai.alloca
//   CHECK-NOT:   tai.alloca
//       CHECK:   tai.stack_create
//   CHECK-NOT:   tai.stack_create
//       CHECK:   memref.alloc
//   CHECK-NOT:   memref.alloc
//       CHECK:   return
func.func @locals(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %half = arith.constant 0.5 : f64
  %a = tai.alloca : !tai.local<f64>
  tai.local_store %half, %a : f64
  %h = tai.local_load %a : f64
  %s = tai.stack_create : !tai.stack<f64>
  tai.stack_push %half, %s : f64
  %v = tai.stack_pop %s : f64
  tai.stack_destroy %s : !tai.stack<f64>
  %m = memref.alloc() : memref<1xf64>
  memref.store %half, %m[%c0] : memref<1xf64>
  %w = memref.load %m[%c0] : memref<1xf64>
  memref.dealloc %m : memref<1xf64>
  %0 = memref.load %x[%c0] : memref<4xf64>
  %1 = arith.mulf %0, %h : f64
  %2 = arith.mulf %1, %v : f64
  %3 = arith.mulf %2, %w : f64
  memref.store %3, %y[%c0] : memref<4xf64>
  return
}

// A parallel loop without a reduction stays as it is.
// CHECK-LABEL: func.func @parallel_fwd(
//       CHECK:   scf.parallel (%{{.+}}) = (%{{.+}}) to (%{{.+}}) step (%{{.+}}) {
//       CHECK:     memref.load
//       CHECK:     %[[D:.+]] = memref.load %[[DX:.+]][
//       CHECK:     memref.store %[[D]]
func.func @parallel(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %0 = memref.load %x[%i] : memref<4xf64>
    memref.store %0, %y[%i] : memref<4xf64>
  }
  return
}

// Output, checks and bits that nothing takes for a float have no derivative.
// CHECK-LABEL: func.func @output_fwd(
//       CHECK:   tai.print
//       CHECK:   tai.assert
//       CHECK:   tai.print
//       CHECK:   memref.store %{{.+}}, %[[Y:.+]]
//       CHECK:   memref.store %{{.+}}, %[[DY:.+]]
func.func @output(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f64
  %0 = memref.load %x[%c0] : memref<4xf64>
  tai.print "{}"(%0) : f64
  %isPositive = arith.cmpf ogt, %0, %zero : f64
  tai.assert %isPositive, "not positive"
  %bits = arith.bitcast %0 : f64 to i64
  tai.print "{}"(%bits) : i64
  memref.store %0, %y[%c0] : memref<4xf64>
  return
}

// A function that has a tangent keeps it.
// CHECK-NOT: _fwd_fwd
