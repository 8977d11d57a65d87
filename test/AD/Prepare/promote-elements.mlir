// RUN: tai-opt %s --tai-promote-elements --tai-eliminate-locals --canonicalize --cse | FileCheck %s

// Elements that are stored, read and stored again at the same indices.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, p: i32, v: vector<2xf32>, v_grad: vector<2xf32>}>, bitmasked<[i: 16], {h: f32, h_grad: f32}>, {a: f32, a_grad: f32}>
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
tai.field @h_grad = @t["h_grad"] : f32, rank 1
tai.field @h = @t["h"] : f32, rank 1, adjoint @h_grad

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

// An index that the loop computes is known there alone. No element is loaded by
// it before the loop, nor looked for for ever.
// CHECK-LABEL: tai.kernel @inner_index
//       CHECK:   scf.for
//       CHECK:     %[[A:.+]] = arith.addi
//       CHECK:     tai.load @x[%[[A]]]
//       CHECK:     tai.store %{{.+}}, @x[%[[A]]]
tai.kernel @inner_index() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) = (%c0) to (%c4) {
    scf.for %k = %c0 to %c4 step %c1 {
      %a = arith.addi %i, %c1 : index
      %0 = tai.load @x[%a] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%a] : f32
    }
  }
  tai.return
}

// With another access that knows the index, or the component, before the first,
// that one is taken.
// CHECK-LABEL: tai.kernel @outer_index
//       CHECK:   tai.parallel_for (%[[I:.+]]) =
//       CHECK:     tai.load @x[%[[I]]]
//       CHECK:     scf.for
//   CHECK-NOT:       @x
//       CHECK:     tai.store %{{.+}}, @x[%[[I]]]
// CHECK-LABEL: tai.kernel @outer_component
//       CHECK:     tai.load @v[%[[I:.+]]] component[%[[C:.+]]]
//       CHECK:     scf.for
//   CHECK-NOT:       @v
//       CHECK:     tai.store %{{.+}}, @v[%[[I]]] component[%[[C]]]
// CHECK-LABEL: tai.kernel @late_index
//       CHECK:     tai.load @x
//       CHECK:     tai.load @x
tai.kernel @outer_index() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) = (%c0) to (%c4) {
    scf.for %k = %c0 to %c4 step %c1 {
      %a = arith.addi %i, %k : index
      %b = arith.subi %a, %k : index
      %0 = tai.load @x[%b] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%b] : f32
    }
    %2 = tai.load @x[%i] : f32
    %3 = math.exp %2 : f32
    tai.store %3, @x[%i] : f32
  }
  tai.return
}
tai.kernel @outer_component(%c: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @v {
    scf.for %k = %c0 to %c4 step %c1 {
      %a = arith.addi %c, %k : index
      %b = arith.subi %a, %k : index
      %0 = tai.load @v[%i] component [%b] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @v[%i] component [%b] : f32
    }
    %2 = tai.load @v[%i] component [%c] : f32
    %3 = math.exp %2 : f32
    tai.store %3, @v[%i] component [%c] : f32
  }
  tai.return
}
tai.kernel @late_index(%m: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) = (%c0) to (%c4) {
    scf.for %k = %c0 to %c4 step %c1 {
      %a = arith.addi %i, %m : index
      %0 = tai.load @x[%a] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%a] : f32
    }
    tai.print "{}"(%i) : index
    %b = arith.addi %i, %m : index
    %2 = tai.load @x[%b] : f32
    %3 = math.exp %2 : f32
    tai.store %3, @x[%b] : f32
  }
  tai.return
}

// Subtractions, of integers too, and updates of arrays are sums; an array's
// update whose result is used is not.
// CHECK-LABEL: tai.kernel @subtracted
//       CHECK:   arith.subf
//   CHECK-NOT:   tai.atomic
// CHECK-LABEL: tai.kernel @integers
//       CHECK:   tai.load @p
//       CHECK:   arith.addi
//       CHECK:   arith.subi
//       CHECK:   tai.store %{{.+}}, @p
//   CHECK-NOT:   tai.atomic
// CHECK-LABEL: func.func @array_sum(
//   CHECK-NOT:   memref.atomic_rmw
//       CHECK:   return
// CHECK-LABEL: func.func @array_sum_with_result(
//       CHECK:   memref.atomic_rmw
//       CHECK:   return
tai.kernel @subtracted() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.atomic sub %1, @x[%i] : f32
    %2 = tai.load @x[%i] : f32
    %3 = math.sin %2 : f32
    tai.store %3, @x[%i] : f32
  }
  tai.return
}
tai.kernel @integers(%b: i32) {
  tai.parallel_for (%i) in @p {
    %0 = tai.load @p[%i] : i32
    %1 = arith.muli %0, %0 : i32
    tai.atomic add %1, @p[%i] : i32
    %2 = tai.load @p[%i] : i32
    %3 = arith.muli %2, %b : i32
    tai.atomic sub %3, @p[%i] : i32
    %4 = tai.load @p[%i] : i32
    tai.store %4, @p[%i] : i32
  }
  tai.return
}
func.func @array_sum(%x: memref<?xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<?xf32>
  %1 = math.sin %0 : f32
  memref.atomic_rmw addf %1, %x[%c0] : (f32, memref<?xf32>) -> f32
  %2 = memref.load %x[%c0] : memref<?xf32>
  %3 = math.sin %2 : f32
  memref.store %3, %x[%c0] : memref<?xf32>
  return
}
func.func @array_sum_with_result(%x: memref<?xf32>, %y: memref<?xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<?xf32>
  %1 = math.sin %0 : f32
  %old = memref.atomic_rmw addf %1, %x[%c0] : (f32, memref<?xf32>) -> f32
  %2 = memref.load %x[%c0] : memref<?xf32>
  %3 = math.sin %2 : f32
  memref.store %3, %x[%c0] : memref<?xf32>
  memref.store %old, %y[%c0] : memref<?xf32>
  return
}

// Without a store that is certain, an element is one's own in serial code, on one
// thread, and where no other iteration has it, but not where a store would make a
// cell active.
// CHECK-LABEL: tai.kernel @serial_sum
//   CHECK-NOT:   tai.atomic
//       CHECK:   tai.store %{{.+}}, @a[]
// CHECK-LABEL: tai.kernel @sum_on_one_thread
//   CHECK-NOT:   tai.atomic
//       CHECK:   tai.store %{{.+}}, @x
// CHECK-LABEL: tai.kernel @own_sum
//   CHECK-NOT:   tai.atomic
//       CHECK:   tai.store %{{.+}}, @x
// CHECK-LABEL: tai.kernel @sum_of_others
//       CHECK:   tai.atomic add
//       CHECK:   tai.atomic add
// CHECK-LABEL: tai.kernel @sum_in_cell
//       CHECK:   tai.atomic add
//       CHECK:   tai.atomic add
tai.kernel @serial_sum() {
  %0 = tai.load @a[] : f32
  %1 = math.sin %0 : f32
  tai.atomic add %1, @a[] : f32
  %2 = tai.load @a[] : f32
  %3 = math.sin %2 : f32
  tai.atomic add %3, @a[] : f32
  tai.return
}
tai.kernel @sum_on_one_thread() {
  tai.parallel_for (%i) in @x serialize {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.atomic add %1, @x[%i] : f32
    %2 = tai.load @x[%i] : f32
    %3 = math.sin %2 : f32
    tai.atomic add %3, @x[%i] : f32
  }
  tai.return
}
tai.kernel @own_sum() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.atomic add %1, @x[%i] : f32
    %2 = tai.load @x[%i] : f32
    %3 = math.sin %2 : f32
    tai.atomic add %3, @x[%i] : f32
  }
  tai.return
}
// Another block of the loop has the element too.
tai.kernel @sum_of_others(%c: i1, %j: index) {
  tai.parallel_for (%i) in @x {
    scf.if %c {
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      tai.atomic add %1, @x[%i] : f32
      %2 = tai.load @x[%i] : f32
      %3 = math.sin %2 : f32
      tai.atomic add %3, @x[%i] : f32
    } else {
      %0 = tai.load @y[%i] : f32
      tai.atomic add %0, @x[%j] : f32
    }
  }
  tai.return
}
tai.kernel @sum_in_cell() {
  tai.parallel_for (%i) in @h {
    %0 = tai.load @h[%i] : f32
    %1 = math.sin %0 : f32
    tai.atomic add %1, @h[%i] : f32
    %2 = tai.load @h[%i] : f32
    %3 = math.sin %2 : f32
    tai.atomic add %3, @h[%i] : f32
  }
  tai.return
}

// A loop whose first iteration is not known may have none.
// CHECK-LABEL: tai.kernel @from_some_number
//       CHECK:   scf.for
//       CHECK:     tai.load @x
//       CHECK:     tai.store %{{.+}}, @x
tai.kernel @from_some_number(%n: index) {
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @x {
    scf.for %k = %n to %c4 step %c1 {
      %0 = tai.load @x[%i] : f32
      %1 = math.sin %0 : f32
      tai.store %1, @x[%i] : f32
    }
  }
  tai.return
}

// A function of several blocks is left alone.
// CHECK-LABEL: func.func @blocks(
//       CHECK:   memref.store
//       CHECK:   memref.load
//       CHECK:   memref.store
func.func @blocks(%x: memref<f32>, %c: i1) attributes {tai.differentiate} {
  %0 = memref.load %x[] : memref<f32>
  cf.cond_br %c, ^next, ^end
^next:
  memref.store %0, %x[] : memref<f32>
  %1 = memref.load %x[] : memref<f32>
  %2 = math.sin %1 : f32
  memref.store %2, %x[] : memref<f32>
  cf.br ^end
^end:
  return
}
