// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-make-adjoint=zero-overwritten --canonicalize --cse | FileCheck %s --check-prefix=TAKES

// Elements that a kernel stores more than once, or reads before it stores them.

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, plain: f32, p: i32, v: vector<2xf32>, v_grad: vector<2xf32>}>, {a: f32, a_grad: f32}>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 0
tai.field @v_grad = @t["v_grad"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @a = @t["a"] : f32, rank 0, adjoint @a_grad
tai.field @v = @t["v"] : vector<2xf32>, rank 1, adjoint @v_grad
tai.field @plain = @t["plain"] : f32, rank 1
tai.field @p = @t["p"] : i32, rank 1

// One store of an element that nothing else in the kernel touches: plain, unless
// the tape asks for more.
// CHECK-LABEL: tai.kernel @once_grad() {
//   CHECK-NOT:   tai.store
//       CHECK:   tai.return
// TAKES-LABEL: tai.kernel @once_grad() attributes {zeroes_adjoint} {
//       TAKES:   %[[ZERO:.+]] = arith.constant 0.0
//       TAKES:   tai.parallel_for (%[[I:.+]]) in
//       TAKES:     %[[G:.+]] = tai.load @y_grad[%[[I]]]
//       TAKES:     tai.store %[[ZERO]], @y_grad[%[[I]]]
//       TAKES:     tai.atomic add %[[G]], @x_grad[%[[I]]]
tai.kernel @once() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
  }
  tai.return
}

// The read value was overwritten: it is needed in its former version. The
// adjoint of the element is taken before that of the old value is added.
// CHECK-LABEL: tai.kernel @in_place_grad() attributes {reads_before = [@x]} {
//       CHECK:   %[[ZERO:.+]] = arith.constant 0.0
//       CHECK:   tai.parallel_for (%[[I:.+]]) in
//       CHECK:     %[[X:.+]] = tai.load @x[%[[I]]]
//       CHECK:     %[[G:.+]] = tai.load @x_grad[%[[I]]]
//       CHECK:     tai.store %[[ZERO]], @x_grad[%[[I]]]
//       CHECK:     %[[COS:.+]] = math.cos %[[X]]
//       CHECK:     %[[GX:.+]] = arith.mulf %[[G]], %[[COS]]
//       CHECK:     tai.atomic add %[[GX]], @x_grad[%[[I]]] exclusive
// TAKES-LABEL: tai.kernel @in_place_grad() attributes {reads_before = [@x], zeroes_adjoint} {
tai.kernel @in_place() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}

// Whether p[i] is i is not known.
// CHECK-LABEL: tai.kernel @indirect_grad() attributes {reads_before = [@x]} {
//       CHECK:     %[[J:.+]] = arith.index_cast
//       CHECK:     tai.load @x_grad[%[[J]]]
//       CHECK:     tai.store %{{.+}}, @x_grad[%[[J]]]
//       CHECK:     tai.atomic add %{{.+}}, @x_grad[%{{.+}}] : f32
tai.kernel @indirect() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    %2 = tai.load @p[%i] : i32
    %3 = arith.index_cast %2 : i32 to index
    tai.store %1, @x[%3] : f32
  }
  tai.return
}

// A sum adds to the old value, which its own derivative needs.
// CHECK-LABEL: tai.kernel @add_square_grad() attributes {reads_before = [@x]} {
//   CHECK-NOT:   tai.store
//       CHECK:   tai.return
tai.kernel @add_square() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.atomic add %1, @x[%i] : f32
  }
  tai.return
}

// A field without an adjoint.
// CHECK-LABEL: tai.kernel @scratch_grad() attributes {reads_before = [@plain]} {
tai.kernel @scratch() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @plain[%i] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.mulf %0, %1 : f32
    tai.store %2, @y[%i] : f32
    tai.store %1, @plain[%i] : f32
  }
  tai.return
}

// Copied and cleared: no value is needed, but a constant takes too.
// CHECK-LABEL: tai.kernel @flush_grad() {
//       CHECK:     tai.store %{{.+}}, @x_grad[%[[I:.+]]] : f32
//       CHECK:     %[[G:.+]] = tai.load @y_grad[%[[I]]]
//       CHECK:     tai.atomic add %[[G]], @x_grad[%[[I]]]
tai.kernel @flush() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
    tai.store %zero, @x[%i] : f32
  }
  tai.return
}

// The second store takes, so that the first gets nothing; the first is the first
// to reach the element.
// CHECK-LABEL: tai.kernel @twice_grad() {
//       CHECK:     %[[G:.+]] = tai.load @y_grad[%[[I:.+]]]
//       CHECK:     tai.store %{{.+}}, @y_grad[%[[I]]]
//       CHECK:     %[[H:.+]] = tai.load @y_grad[%[[I]]]
//   CHECK-NOT:     tai.store
//       CHECK:   tai.return
tai.kernel @twice() {
  %two = arith.constant 2.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%i] : f32
    %1 = arith.mulf %0, %two : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// A store in a serial loop meets itself.
// CHECK-LABEL: tai.kernel @last_counts_grad() {
//       CHECK:     scf.for
//       CHECK:       tai.load @y_grad
//       CHECK:       tai.store %{{.+}}, @y_grad
tai.kernel @last_counts() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @x {
    scf.for %k = %c0 to %c4 step %c1 {
      %0 = tai.load @x[%k] : f32
      tai.store %0, @y[%i] : f32
    }
  }
  tai.return
}

// Along the axis of a recurrence, each element is stored once, and read after.
// CHECK-LABEL: tai.kernel @recurrence_grad(%{{.+}}: index) {
//   CHECK-NOT:   tai.store
//       CHECK:   tai.return
tai.kernel @recurrence(%n: index) {
  %c1 = arith.constant 1 : index
  scf.for %j = %c1 to %n step %c1 {
    %k = arith.subi %j, %c1 : index
    %0 = tai.load @x[%k] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%j] : f32
  }
  tai.return
}

// The other way round each is read before it is stored.
// CHECK-LABEL: tai.kernel @shift_grad(%{{.+}}: index) attributes {reads_before = [@x]} {
//       CHECK:   tai.store %{{.+}}, @x_grad
tai.kernel @shift(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  scf.for %j = %c0 to %n step %c1 {
    %k = arith.addi %j, %c1 : index
    %0 = tai.load @x[%k] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%j] : f32
  }
  tai.return
}

// Even and odd elements are apart, and so are blocks of a known size.
// CHECK-LABEL: tai.kernel @apart_grad() {
//   CHECK-NOT:   tai.store
//       CHECK:   tai.return
tai.kernel @apart() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%c4) {
    %even = arith.muli %i, %c2 : index
    %odd = arith.addi %even, %c1 : index
    %0 = tai.load @x[%even] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @x[%odd] : f32
  }
  tai.parallel_for (%i) = (%c0) to (%c4) {
    %1 = tai.load @y[%i] : f32
    %2 = math.sin %1 : f32
    %far = arith.addi %i, %c8 : index
    tai.store %2, @y[%far] : f32
  }
  tai.return
}

// A component is an element of its own, if both are known.
// CHECK-LABEL: tai.kernel @component_grad() {
//   CHECK-NOT:   tai.store
//       CHECK:   tai.return
tai.kernel @component() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @v {
    %0 = tai.load @v[%i] component [%c0] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @v[%i] component [%c1] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @some_component_grad(%{{.+}}: index) attributes {reads_before = [@v]} {
//       CHECK:     tai.store %{{.+}}, @v_grad[%{{.+}}] component[%{{.+}}] : f32
tai.kernel @some_component(%c: index) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @v {
    %0 = tai.load @v[%i] component [%c0] : f32
    %1 = math.sin %0 : f32
    tai.store %1, @v[%i] component [%c] : f32
  }
  tai.return
}

// A value of the top level is overwritten: its adjoint is summed beside.
// CHECK-LABEL: tai.kernel @captured_grad() attributes {reads_before = [@a]} {
//       CHECK:   %[[SUM:.+]] = memref.alloca
//       CHECK:   tai.parallel_for
//   CHECK-NOT:     @a_grad
//       CHECK:     memref.atomic_rmw addf %{{.+}}, %[[SUM]]
//       CHECK:   }
//       CHECK:   tai.store %{{.+}}, @a_grad[]
//       CHECK:   tai.atomic add %{{.+}}, @a_grad[]
tai.kernel @captured() {
  %zero = arith.constant 0.0 : f32
  %a = tai.load @a[] : f32
  tai.store %zero, @a[] : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %p = arith.mulf %x, %a : f32
    tai.store %p, @y[%i] : f32
  }
  tai.return
}

// Arrays of the caller.
// CHECK-LABEL: func.func @copy_and_clear_grad(
//  CHECK-SAME:     %{{.+}}: memref<?xf32>, %{{.+}}: memref<?xf32>, %[[GX:.+]]: memref<?xf32>, %[[GY:.+]]: memref<?xf32>)
//       CHECK:   memref.store %{{.+}}, %[[GX]]
//       CHECK:   %[[G:.+]] = memref.load %[[GY]]
//       CHECK:   %[[OLD:.+]] = memref.load %[[GX]]
//       CHECK:   arith.addf %[[OLD]], %[[G]]
func.func @copy_and_clear(%x: memref<?xf32>, %y: memref<?xf32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f32
  %0 = memref.load %x[%c0] : memref<?xf32>
  memref.store %0, %y[%c0] : memref<?xf32>
  memref.store %zero, %x[%c0] : memref<?xf32>
  return
}

// The additions of a stencil are to be gathered, so their operands are not
// zeroed until they are done.
// CHECK-LABEL: tai.kernel @stencil_grad()
//   CHECK-NOT:   tai.store
//       CHECK:   tai.return
// TAKES-LABEL: tai.kernel @stencil_grad() attributes {zeroes_adjoint} {
//       TAKES:   tai.parallel_for
//   TAKES-NOT:     tai.store
//       TAKES:     %[[G:.+]] = tai.load @y_grad
//       TAKES:     tai.atomic add %{{.+}}, @x_grad
//       TAKES:     tai.atomic add %{{.+}}, @x_grad
//       TAKES:   }
//       TAKES:   tai.parallel_for (%[[I:.+]]) =
//  TAKES-NEXT:     tai.store %{{.+}}, @y_grad[%[[I]]]
//  TAKES-NEXT:   }
tai.kernel @stencil() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c15 = arith.constant 15 : index
  tai.parallel_for (%i) = (%c0) to (%c15) {
    %next = arith.addi %i, %c1 : index
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @x[%next] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @y[%i] : f32
  }
  tai.return
}
