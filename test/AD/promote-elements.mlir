// RUN: tai-opt %s --tai-promote-elements --tai-eliminate-locals --canonicalize --cse | FileCheck %s

// Elements that are stored, read and stored again at the same indices.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, p: i32, v: vector<2xf32>, v_grad: vector<2xf32>}>, {a: f32, a_grad: f32}>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 0
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @a = @t["a"] : f32, rank 0, adjoint @a_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @p = @t["p"] : i32, rank 1

// CHECK-LABEL: tai.kernel @sequence
//       CHECK:     %[[Y:.+]] = tai.load @y
//   CHECK-NOT:     tai.load @x
//       CHECK:     %[[S:.+]] = math.sin %[[Y]]
//       CHECK:     %[[E:.+]] = math.exp %[[S]]
//       CHECK:     tai.store %[[E]], @x
//   CHECK-NOT:     tai.store
//       CHECK:   tai.return
tai.kernel @sequence() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @y[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
    %2 = tai.load @x[%i] : f32
    %3 = math.exp %2 : f32
    tai.store %3, @x[%i] : f32
  }
  tai.return
}

// Through loops and branches; additions to an element of one's own are sums.
// CHECK-LABEL: tai.kernel @nested
//       CHECK:   tai.parallel_for (%[[I:.+]]) in
//       CHECK:     %[[X:.+]] = tai.load @x[%[[I]]]
//       CHECK:     %[[R:.+]] = scf.for %{{.+}} iter_args(%[[OLD:.+]] = %[[X]]) -> (f32) {
//       CHECK:       %[[SIN:.+]] = math.sin %[[OLD]]
//       CHECK:       %[[SUM:.+]] = arith.addf %[[OLD]], %[[SIN]]
//       CHECK:       %[[NEW:.+]] = scf.if
//       CHECK:         scf.yield %{{.+}} : f32
//       CHECK:       scf.yield %[[NEW]]
//       CHECK:     tai.store %[[R]], @x[%[[I]]]
//   CHECK-NOT:     @x
//       CHECK:   tai.return
tai.kernel @nested(%c: i1) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %two = arith.constant 2.0 : f32
  tai.parallel_for (%i) in @x {
    scf.for %k = %c0 to %c4 step %c1 {
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      tai.atomic add %1, @x[%i] : f32
      scf.if %c {
        %2 = tai.load @x[%i] : f32
        %3 = arith.mulf %2, %two : f32
        tai.store %3, @x[%i] : f32
      }
    }
  }
  tai.return
}

// Serial code owns its elements.
// CHECK-LABEL: tai.kernel @serial
//       CHECK:   %[[A:.+]] = tai.load @a[]
//       CHECK:   %[[R:.+]] = scf.for %{{.+}} iter_args(%{{.+}} = %[[A]])
//       CHECK:   tai.store %[[R]], @a[]
tai.kernel @serial() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  scf.for %k = %c0 to %c4 step %c1 {
    %0 = tai.load @a[] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @a[] : f32
  }
  tai.return
}

// One component.
// CHECK-LABEL: tai.kernel @component
//       CHECK:     math.sin
//       CHECK:     math.exp
//       CHECK:     tai.store %{{.+}}, @v[%{{.+}}] component[%{{.+}}] : f32
//   CHECK-NOT:     tai.store
//       CHECK:   tai.return
tai.kernel @component() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @v {
    %0 = tai.load @v[%i] component [%c0] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @v[%i] component [%c0] : f32
    %2 = tai.load @v[%i] component [%c0] : f32
    %3 = math.exp %2 : f32
    tai.store %3, @v[%i] component [%c0] : f32
  }
  tai.return
}

// A kernel that needs one state only is not changed: a time step that is read
// again, and a state changed in place.
// CHECK-LABEL: tai.kernel @one_state
//       CHECK:     tai.store %{{.+}}, @y
//       CHECK:     tai.load @y
//       CHECK:     tai.load @x
//       CHECK:     tai.store %{{.+}}, @x
tai.kernel @one_state() {
  tai.parallel_for (%i) in @x {
    %s = arith.constant 1.0 : f32
    tai.store %s, @y[%i] : f32
    %0 = tai.load @y[%i] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.mulf %1, %0 : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// Another access may meet the element.
// CHECK-LABEL: tai.kernel @may_meet
//       CHECK:     tai.store
//       CHECK:     tai.load @x
//       CHECK:     tai.store
//       CHECK:     tai.store
tai.kernel @may_meet() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @y[%i] : f32
    %1 = tai.load @p[%i] : i32
    %j = arith.index_cast %1 : i32 to index
    tai.store %0, @x[%i] : f32
    %2 = tai.load @x[%i] : f32
    tai.store %0, @x[%j] : f32
    %3 = math.exp %2 : f32
    tai.store %3, @x[%i] : f32
  }
  tai.return
}

// The iteration that stores is not known: others must not store.
// CHECK-LABEL: tai.kernel @not_owned
//       CHECK:     scf.if
//       CHECK:       tai.load @a
//       CHECK:       tai.store %{{.+}}, @a
//       CHECK:   tai.return
tai.kernel @not_owned(%k: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @x {
    %is = arith.cmpi eq, %i, %k : index
    scf.for %t = %c0 to %c4 step %c1 {
      scf.if %is {
        %0 = tai.load @a[] : f32
        %1 = math.sin %0 : f32
        tai.store %1, @a[] : f32
      }
    }
  }
  tai.return
}

// Arrays.
// CHECK-LABEL: func.func @array(
//       CHECK:   %[[X:.+]] = memref.load %{{.+}}
//       CHECK:   %[[S:.+]] = math.sin %[[X]]
//       CHECK:   %[[E:.+]] = math.exp %[[S]]
//       CHECK:   memref.store %[[E]], %{{.+}}
//   CHECK-NOT:   memref
//       CHECK:   return
func.func @array(%x: memref<?xf32>, %y: memref<?xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<?xf32>
  %1 = math.sin %0 : f32
  memref.store %1, %y[%c0] : memref<?xf32>
  %2 = memref.load %y[%c0] : memref<?xf32>
  %3 = math.exp %2 : f32
  memref.store %3, %y[%c0] : memref<?xf32>
  return
}
