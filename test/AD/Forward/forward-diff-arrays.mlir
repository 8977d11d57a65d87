// RUN: tai-opt %s --tai-forward-diff --canonicalize --cse | FileCheck %s

// Atomic updates of arrays, and of fields beside them.

// The value before an assignment has the tangent that stood there.
// CHECK-LABEL: func.func @set_fwd(
//  CHECK-SAME:     %[[X:.+]]: memref<4xf64>, %[[Y:.+]]: memref<4xf64>, %[[DX:.+]]: memref<4xf64>, %[[DY:.+]]: memref<4xf64>)
//       CHECK:   %[[DV:.+]] = memref.load %[[DX]]
//       CHECK:   %[[OLD:.+]] = memref.atomic_rmw assign %{{.+}}, %[[Y]]
//       CHECK:   %[[DOLD:.+]] = memref.load %[[DY]]
//       CHECK:   memref.store %[[DV]], %[[DY]]
//       CHECK:   memref.store %[[OLD]], %[[X]]
//       CHECK:   memref.store %[[DOLD]], %[[DX]]
// CHECK-LABEL: func.func @clear_fwd(
//  CHECK-SAME:     %{{.+}}: memref<4xf64>, %[[DY:[a-z0-9]+]]: memref<4xf64>)
//       CHECK:   %[[ZERO:.+]] = arith.constant 0.0
//       CHECK:   memref.store %[[ZERO]], %[[DY]]
func.func @set(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  %1 = memref.atomic_rmw assign %0, %y[%c0] : (f64, memref<4xf64>) -> f64
  memref.store %1, %x[%c0] : memref<4xf64>
  return
}
func.func @clear(%y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %half = arith.constant 0.5 : f64
  memref.atomic_rmw assign %half, %y[%c0] : (f64, memref<4xf64>) -> f64
  return
}

// A sum is a sum of tangents. One whose former value is used has an element of
// its own, and the tangent is read before it is added to.
// CHECK-LABEL: func.func @add_fwd(
//  CHECK-SAME:     %[[X:.+]]: memref<4xf64>, %[[Y:.+]]: memref<4xf64>, %[[Z:.+]]: memref<4xf64>, %[[DX:.+]]: memref<4xf64>, %[[DY:.+]]: memref<4xf64>, %[[DZ:.+]]: memref<4xf64>)
//       CHECK:   scf.parallel
//       CHECK:     %[[DV:.+]] = memref.load %[[DX]]
//       CHECK:     memref.atomic_rmw addf %{{.+}}, %[[Y]]
//       CHECK:     memref.atomic_rmw addf %[[DV]], %[[DY]]
//       CHECK:     %[[OLD:.+]] = memref.atomic_rmw addf %{{.+}}, %[[Z]]
//       CHECK:     %[[DOLD:.+]] = memref.load %[[DZ]]
//       CHECK:     memref.atomic_rmw addf %[[DV]], %[[DZ]]
//       CHECK:     memref.store %[[OLD]], %[[X]]
//       CHECK:     memref.store %[[DOLD]], %[[DX]]
func.func @add(%x: memref<4xf64>, %y: memref<4xf64>, %z: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %0 = memref.load %x[%i] : memref<4xf64>
    memref.atomic_rmw addf %0, %y[%c0] : (f64, memref<4xf64>) -> f64
    %1 = memref.atomic_rmw addf %0, %z[%i] : (f64, memref<4xf64>) -> f64
    memref.store %1, %x[%i] : memref<4xf64>
  }
  return
}

// What is constant scales the tangent, and adds nothing to it.
// CHECK-LABEL: func.func @scale_fwd(
//  CHECK-SAME:     %[[K:.+]]: f64, %[[Y:.+]]: memref<4xf64>, %[[DY:.+]]: memref<4xf64>)
//       CHECK:     memref.atomic_rmw mulf %[[K]], %[[Y]]
//       CHECK:     memref.atomic_rmw mulf %[[K]], %[[DY]]
//       CHECK:     memref.atomic_rmw addf %[[K]], %[[Y]]
//   CHECK-NOT:     %[[DY]]
//       CHECK:   return
func.func @scale(%k: f64, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    memref.atomic_rmw mulf %k, %y[%c0] : (f64, memref<4xf64>) -> f64
    memref.atomic_rmw addf %k, %y[%c1] : (f64, memref<4xf64>) -> f64
  }
  return
}

// Each iteration has its own element, and a former value wins if it is beyond
// the new one.
// CHECK-LABEL: func.func @own_fwd(
//       CHECK:   scf.parallel
//       CHECK:     %[[X:.+]] = memref.load
//       CHECK:     %[[DX:.+]] = memref.load
//       CHECK:     %[[P:.+]] = memref.atomic_rmw mulf %[[X]]
//       CHECK:     %[[DP:.+]] = memref.load
//   CHECK-DAG:     %[[KEPT:.+]] = arith.mulf %[[DP]], %[[X]]
//   CHECK-DAG:     %[[ADDED:.+]] = arith.mulf %[[P]], %[[DX]]
//       CHECK:     arith.addf %[[KEPT]], %[[ADDED]]
//       CHECK:     %[[A:.+]] = memref.atomic_rmw maximumf %[[X]]
//       CHECK:     %[[DA:.+]] = memref.load
//       CHECK:     %[[STAYS:.+]] = arith.cmpf ogt, %[[A]], %[[X]]
//       CHECK:     arith.select %[[STAYS]], %[[DA]], %[[DX]]
//       CHECK:     %[[B:.+]] = memref.atomic_rmw maxnumf %[[X]]
//       CHECK:     arith.cmpf ogt, %[[B]], %[[X]]
//       CHECK:     %[[C:.+]] = memref.atomic_rmw minimumf %[[X]]
//       CHECK:     arith.cmpf olt, %[[C]], %[[X]]
//       CHECK:     %[[D:.+]] = memref.atomic_rmw minnumf %[[X]]
//       CHECK:     arith.cmpf olt, %[[D]], %[[X]]
func.func @own(%x: memref<4xf64>, %p: memref<4xf64>, %a: memref<4xf64>, %b: memref<4xf64>, %c: memref<4xf64>, %d: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %0 = memref.load %x[%i] : memref<4xf64>
    memref.atomic_rmw mulf %0, %p[%i] : (f64, memref<4xf64>) -> f64
    memref.atomic_rmw maximumf %0, %a[%i] : (f64, memref<4xf64>) -> f64
    memref.atomic_rmw maxnumf %0, %b[%i] : (f64, memref<4xf64>) -> f64
    memref.atomic_rmw minimumf %0, %c[%i] : (f64, memref<4xf64>) -> f64
    memref.atomic_rmw minnumf %0, %d[%i] : (f64, memref<4xf64>) -> f64
  }
  return
}

// At a tie with the choice 'split', half of either.
// CHECK-LABEL: func.func @half_fwd(
//       CHECK:   %[[OLD:.+]] = memref.atomic_rmw maximumf %[[X:[a-z0-9]+]],
//       CHECK:   %[[TIE:.+]] = arith.cmpf oeq, %[[OLD]], %[[X]]
//       CHECK:   %[[HALF:.+]] = arith.mulf %{{.+}}, %{{.+}}
//       CHECK:   arith.select %[[TIE]], %[[HALF]],
func.func @half(%x: memref<4xf64>, %p: memref<4xf64>) attributes {tai.differentiate, tai.conventions = {ties = "split"}} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<4xf64>
  memref.atomic_rmw maximumf %0, %p[%c0] : (f64, memref<4xf64>) -> f64
  return
}

// A factor that may be infinite takes nothing of a tangent that is zero.
// CHECK-LABEL: func.func @infinite_factor_fwd(
//       CHECK:   %[[Q:.+]] = arith.divf
//       CHECK:   memref.atomic_rmw mulf %[[Q]]
//       CHECK:   %[[OLD:.+]] = memref.load
//       CHECK:   %[[KEPT:.+]] = arith.mulf %[[OLD]], %[[Q]]
//       CHECK:   %[[ZERO:.+]] = arith.cmpf oeq, %[[OLD]],
//       CHECK:   arith.select %[[ZERO]], %{{.+}}, %[[KEPT]] {tai.guard}
func.func @infinite_factor(%x: memref<4xf64>, %p: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %one = arith.constant 1.0 : f64
  %0 = memref.load %x[%c0] : memref<4xf64>
  %1 = arith.divf %one, %0 : f64
  memref.atomic_rmw mulf %1, %p[%c0] : (f64, memref<4xf64>) -> f64
  return
}

// An array of the iteration is met by no other, wherever the index points. So is
// an element that both indices of two loops tell apart, and none that one of
// them does.
// CHECK-LABEL: func.func @of_iteration_fwd(
//       CHECK:   scf.parallel
//       CHECK:     memref.alloca
//       CHECK:     memref.alloca
//       CHECK:     memref.atomic_rmw mulf
// CHECK-LABEL: func.func @two_loops_fwd(
//       CHECK:   memref.atomic_rmw mulf
func.func @of_iteration(%x: memref<4xf64>, %y: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %half = arith.constant 0.5 : f64
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    %m = memref.alloca() : memref<1xf64>
    %0 = memref.load %x[%i] : memref<4xf64>
    memref.store %half, %m[%c0] : memref<1xf64>
    memref.atomic_rmw mulf %0, %m[%c0] : (f64, memref<1xf64>) -> f64
    %1 = memref.load %m[%c0] : memref<1xf64>
    memref.store %1, %y[%i] : memref<4xf64>
  }
  return
}
func.func @two_loops(%x: memref<4xf64>, %q: memref<4x4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.parallel (%i) = (%c0) to (%c4) step (%c1) {
    scf.parallel (%j) = (%c0) to (%c4) step (%c1) {
      %0 = memref.load %x[%i] : memref<4xf64>
      memref.atomic_rmw mulf %0, %q[%i, %j] : (f64, memref<4x4xf64>) -> f64
    }
  }
  return
}

// Iterations that meet run in order, and those of a loop on one thread do so
// already. Accesses to fields are no accesses to the array.
// CHECK-LABEL: tai.kernel @in_order_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) in @f serialize {
//       CHECK:     memref.atomic_rmw mulf
// CHECK-LABEL: tai.kernel @ordered_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) in @f serialize {
//       CHECK:     memref.atomic_rmw mulf
// CHECK-LABEL: tai.kernel @both_kinds_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) in @f {
//       CHECK:     tai.atomic mul
// CHECK-LABEL: tai.kernel @serial_fwd(
//       CHECK:   tai.atomic mul
tai.tree @t : !tai.root<dense<[i: 4], {f: f64, df: f64, g: f64, dg: f64}>>
tai.field @df = @t["df"] : f64, rank 1
tai.field @f = @t["f"] : f64, rank 1, dual @df
tai.field @dg = @t["dg"] : f64, rank 1
tai.field @g = @t["g"] : f64, rank 1, dual @dg
tai.kernel @in_order(%p: memref<4xf64>) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @f {
    %0 = tai.load @f[%i] : f64
    memref.atomic_rmw mulf %0, %p[%c0] : (f64, memref<4xf64>) -> f64
  }
  tai.return
}
tai.kernel @ordered(%p: memref<4xf64>) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @f serialize {
    %0 = tai.load @f[%i] : f64
    memref.atomic_rmw mulf %0, %p[%c0] : (f64, memref<4xf64>) -> f64
  }
  tai.return
}
tai.kernel @both_kinds(%p: memref<4xf64>) {
  tai.parallel_for (%i) in @f {
    %0 = tai.load @f[%i] : f64
    memref.store %0, %p[%i] : memref<4xf64>
    tai.atomic mul %0, @g[%i] : f64
  }
  tai.return
}
tai.kernel @serial() {
  %c0 = arith.constant 0 : index
  %0 = tai.load @f[%c0] : f64
  tai.atomic mul %0, @g[%c0] : f64
  tai.return
}

// An infinite tangent stays one in an array of the function: a factor of zero
// takes nothing of it.
// CHECK-LABEL: func.func @infinite_in_array_fwd(
//       CHECK:   %[[Z:.+]] = memref.load %arg1
//       CHECK:   arith.mulf %{{.+}}, %[[Z]]
//       CHECK:   %[[NONE:.+]] = arith.cmpf oeq, %[[Z]],
//       CHECK:   arith.select %[[NONE]], %{{.+}}, %{{.+}} {tai.guard}
func.func @infinite_in_array(%x: memref<4xf64>, %z: memref<4xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %m = memref.alloca() : memref<1xf64>
  %0 = memref.load %x[%c0] : memref<4xf64>
  %1 = math.sqrt %0 : f64
  memref.store %1, %m[%c0] : memref<1xf64>
  %2 = memref.load %z[%c0] : memref<4xf64>
  %3 = memref.load %m[%c0] : memref<1xf64>
  %4 = arith.mulf %3, %2 : f64
  memref.store %4, %x[%c1] : memref<4xf64>
  return
}
