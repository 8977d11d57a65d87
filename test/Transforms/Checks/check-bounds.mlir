// RUN: tai-opt %s --tai-check-bounds --canonicalize --cse | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 8], {x: f32, k: i32}>, dense<[i: 4, j: 8], {m: f32}>, dense<[i: 16], {o: f32}>, dense<[i: 1], {one: f32}>, dense<[i: 8], {v: vector<3xf32>}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @k = @t["k"] : i32, rank 1
tai.field @one = @t["one"] : f32, rank 1
tai.field @m = @t["m"] : f32, rank 2
tai.field @v = @t["v"] : vector<3xf32>, rank 1
// From 10 to 25.
tai.field @o = @t["o"] : f32, rank 1, offset [10]

// A loop over the field itself: nothing is left of the pass.
// CHECK-LABEL: tai.kernel @proven(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @proven() {
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    tai.store %zero, @x[%i] : f32
  }
  tai.parallel_for (%i) = (%c1) to (%c7) {
    %l = arith.subi %i, %c1 : index
    %r = arith.addi %i, %c1 : index
    %a = tai.load @x[%l] : f32
    %b = tai.load @x[%r] : f32
    %s = arith.addf %a, %b : f32
    tai.store %s, @x[%i] : f32
  }
  tai.return
}

// The upper bound is an argument: one comparison for all accesses at %i.
// CHECK-LABEL: tai.kernel @argument(
//  CHECK-SAME:     %[[N:.+]]: i32)
//   CHECK-DAG:   %[[C8:.+]] = arith.constant 8 : i64
//   CHECK-DAG:   %[[C9:.+]] = arith.constant 9 : i64
//       CHECK:   %[[W:.+]] = arith.extsi %[[N]] : i32 to i64
//       CHECK:   %[[OK:.+]] = arith.cmpi slt, %[[W]], %[[C9]]
//       CHECK:   tai.precondition %[[OK]], "index [{}] is out of range for field '@x' of shape [8]"(%[[C8]]) : i64
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.parallel_for
tai.kernel @argument(%n: i32) {
  %c0 = arith.constant 0 : index
  %to = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%c0) to (%to) {
    %a = tai.load @x[%i] : f32
    tai.store %a, @x[%i] : f32
  }
  tai.return
}

// No loop at all, and an index space that does not begin at zero: both sides.
// CHECK-LABEL: tai.kernel @direct(
//       CHECK:   tai.precondition %{{.+}} "index [{}] is out of range for field '@o' of shape [16] from [10]"
//       CHECK:   tai.precondition %{{.+}} "index [{}] is out of range for field '@o' of shape [16] from [10]"
tai.kernel @direct(%n: i32) -> f32 {
  %i = arith.index_cast %n : i32 to index
  %a = tai.load @o[%i] : f32
  tai.return %a : f32
}

// With 64 bits, all numbers beyond the range are refused, however large.
// CHECK-LABEL: tai.kernel @wide(
//   CHECK-NOT:   arith.addi
//       CHECK:   arith.cmpi s{{gt|ge|lt|le}}, %{{.+}}, %{{.+}} : i64
//   CHECK-NOT:   arith.cmpi
//       CHECK:   tai.precondition
//       CHECK:   arith.cmpi s{{gt|ge|lt|le}}, %{{.+}}, %{{.+}} : i64
//   CHECK-NOT:   arith.cmpi
//       CHECK:   tai.precondition
tai.kernel @wide(%i: index) -> f32 {
  %a = tai.load @x[%i] : f32
  tai.return %a : f32
}

// Wrong in every launch.
// CHECK-LABEL: tai.kernel @always(
//   CHECK-DAG:   %[[NO:.+]] = arith.constant false
//   CHECK-DAG:   %[[C8:.+]] = arith.constant 8 : i64
//       CHECK:   tai.precondition %[[NO]], "index [{}] is out of range for field '@x' of shape [8]"(%[[C8]])
tai.kernel @always() {
  %c0 = arith.constant 0 : index
  %c9 = arith.constant 9 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c9) {
    tai.store %zero, @x[%i] : f32
  }
  tai.return
}

// An empty loop touches nothing.
// CHECK-LABEL: tai.kernel @empty(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @empty() {
  %c0 = arith.constant 0 : index
  %c100 = arith.constant 100 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c100) to (%c0) {
    tai.store %zero, @x[%i] : f32
  }
  tai.return
}

// Iterations that conditions on indices leave out are left out: ghost cells,
// one side and the other, as "and", as "or", and by negation.
// CHECK-LABEL: tai.kernel @guarded(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @guarded(%n: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %l = arith.subi %i, %c1 : index
    %r = arith.addi %i, %c1 : index
    %inside = arith.cmpi sgt, %i, %c0 : index
    scf.if %inside {
      tai.store %zero, @x[%l] : f32
    }
    %atEnd = arith.cmpi eq, %i, %c7 : index
    scf.if %atEnd {
    } else {
      tai.store %zero, @x[%r] : f32
    }
    %below = arith.cmpi slt, %l, %c0 : index
    %above = arith.cmpi sge, %r, %c8 : index
    %out = arith.ori %below, %above : i1
    scf.if %out {
    } else {
      tai.store %zero, @x[%l] : f32
      tai.store %zero, @x[%r] : f32
    }
  }
  // Up to any number, but only those in range.
  %to = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%c0) to (%to) {
    %in = arith.cmpi slt, %i, %c8 : index
    scf.if %in {
      tai.store %zero, @x[%i] : f32
    }
  }
  tai.return
}

// A guard that is off by one is found, at the one index that it lets through.
// CHECK-LABEL: tai.kernel @wrong_guard(
//   CHECK-DAG:   %[[NO:.+]] = arith.constant false
//   CHECK-DAG:   %[[AT:.+]] = arith.constant -1 : i64
//       CHECK:   tai.precondition %[[NO]], {{.+}}(%[[AT]])
tai.kernel @wrong_guard() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %l = arith.subi %i, %c1 : index
    %inside = arith.cmpi sge, %i, %c0 : index
    scf.if %inside {
      tai.store %zero, @x[%l] : f32
    }
  }
  tai.return
}

// An access by data, or under a condition of data, is not certain.
// CHECK-LABEL: tai.kernel @uncertain(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @uncertain(%n: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  %none = arith.constant 0 : i32
  %by = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) in @x {
    %k = tai.load @k[%i] : i32
    %at = arith.index_cast %k : i32 to index
    tai.store %zero, @x[%at] : f32
    %r = arith.addi %i, %by : index
    %some = arith.cmpi ne, %k, %none : i32
    scf.if %some {
      tai.store %zero, @x[%r] : f32
    }
    scf.while : () -> () {
      %go = arith.cmpi ne, %k, %none : i32
      scf.condition(%go)
    } do {
      tai.store %zero, @x[%r] : f32
      scf.yield
    }
    %last = arith.minsi %r, %c1 : index
    %in = arith.maxsi %last, %c0 : index
    tai.store %zero, @x[%in] : f32
  }
  tai.return
}

// A triangle: the inner loop is empty where the outer one is at its last index,
// so that %i never is 8.
// CHECK-LABEL: tai.kernel @triangle(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @triangle() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%c9) {
    %from = arith.addi %i, %c1 : index
    scf.for %j = %from to %c9 step %c1 {
      tai.store %zero, @x[%i] : f32
    }
  }
  tai.return
}

// Two dimensions, and a serial loop in a parallel one: the first iteration that
// leaves the field is reported.
// CHECK-LABEL: tai.kernel @nested(
//  CHECK-SAME:     %[[N:.+]]: i32, %[[S:.+]]: i32)
//       CHECK:   tai.precondition %{{.+}}, "index [{}, {}] is out of range for field '@m' of shape [4, 8]"(%{{.+}}, %{{.+}}) : i64, i64
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @nested(%n: i32, %s: i32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  %zero = arith.constant 0.0 : f32
  %to = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%c0) to (%c4) {
    scf.for %j = %c0 to %to step %c1 {
      %twice = arith.muli %j, %c2 : index
      %at = arith.addi %twice, %i : index
      tai.store %zero, @m[%i, %at] : f32
    }
  }
  tai.return
}

// Steps: 0, 3, 6 and no more.
// CHECK-LABEL: tai.kernel @steps(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @steps() {
  %c0 = arith.constant 0 : index
  %c3 = arith.constant 3 : index
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  %zero = arith.constant 0.0 : f32
  scf.for %j = %c0 to %c9 step %c3 {
    %at = arith.addi %j, %c1 : index
    tai.store %zero, @x[%at] : f32
  }
  tai.return
}

// One iteration, whose index is no variable.
// CHECK-LABEL: tai.kernel @one_step(
//       CHECK:   %[[NO:.+]] = arith.constant false
//       CHECK:   tai.precondition %[[NO]], "index [{}] is out of range for field '@x' of shape [8]"
//       CHECK:   tai.store
tai.kernel @one_step() {
  %c7 = arith.constant 7 : index
  %c3 = arith.constant 3 : index
  %c1 = arith.constant 1 : index
  %c9 = arith.constant 9 : index
  %zero = arith.constant 0.0 : f32
  scf.for %j = %c7 to %c9 step %c3 {
    %at = arith.addi %j, %c1 : index
    tai.store %zero, @x[%at] : f32
  }
  tai.return
}

// The same in another loop, whose variable is not to be taken for it.
// CHECK-LABEL: tai.kernel @one_step_inside(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @one_step_inside() {
  %c6 = arith.constant 6 : index
  %c3 = arith.constant 3 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    scf.for %j = %c6 to %c8 step %c3 {
      %at = arith.addi %j, %c1 : index
      tai.store %zero, @x[%at] : f32
      tai.store %zero, @x[%i] : f32
    }
  }
  tai.return
}

// An axis of one element.
// CHECK-LABEL: tai.kernel @one_element(
//       CHECK:   tai.precondition {{.+}} "index [{}] is out of range for field '@one' of shape [1]"
tai.kernel @one_element() {
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @one {
    %at = arith.addi %i, %c1 : index
    tai.store %zero, @one[%at] : f32
    tai.store %zero, @one[%i] : f32
  }
  tai.return
}

// Indices that wrap around, and remainders.
// CHECK-LABEL: tai.kernel @wraps(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @wraps(%n: i32) {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %one = arith.constant 1 : i32
  %eight = arith.constant 8 : i32
  %zero = arith.constant 0.0 : f32
  %to = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) in @x {
    %w = arith.index_cast %i : index to i32
    %l = arith.subi %w, %one : i32
    %q = arith.floordivsi %l, %eight : i32
    %p = arith.muli %q, %eight : i32
    %r = arith.subi %l, %p : i32
    %at = arith.index_cast %r : i32 to index
    tai.store %zero, @x[%at] : f32
  }
  %c16 = arith.constant 16 : index
  tai.parallel_for (%i) = (%c0) to (%c16) {
    %half = arith.floordivsi %i, %c2 : index
    tai.store %zero, @x[%half] : f32
  }
  tai.return
}

// Half of 16 is out of range, and so are later iterations.
// CHECK-LABEL: tai.kernel @halves(
//   CHECK-DAG:   %[[C8:.+]] = arith.constant 8 : i64
//       CHECK:   tai.precondition %{{.+}}, {{.+}}(%[[C8]])
tai.kernel @halves(%n: i32) {
  %c0 = arith.constant 0 : index
  %c2 = arith.constant 2 : index
  %zero = arith.constant 0.0 : f32
  %to = arith.index_cast %n : i32 to index
  tai.parallel_for (%i) = (%c0) to (%to) {
    %half = arith.floordivsi %i, %c2 : index
    tai.store %zero, @x[%half] : f32
  }
  tai.return
}

// A condition on arguments is part of the test.
// CHECK-LABEL: tai.kernel @switch(
//  CHECK-SAME:     %[[ON:.+]]: i1)
//       CHECK:   tai.precondition
tai.kernel @switch(%on: i1) {
  %c8 = arith.constant 8 : index
  %zero = arith.constant 0.0 : f32
  scf.if %on {
    tai.store %zero, @x[%c8] : f32
  }
  tai.return
}

// The component is out of range, and not the index of the element.
// CHECK-LABEL: tai.kernel @component(
//  CHECK-SAME:     %[[C:.+]]: i32)
//       CHECK:   %[[N:.+]] = arith.extsi %[[C]] : i32 to i64
//       CHECK:   tai.precondition %{{.+}}, "index [{}] is out of range for an element of shape [3] of field '@v'"(%[[N]])
//       CHECK:   tai.parallel_for
tai.kernel @component(%c: i32) {
  %zero = arith.constant 0.0 : f32
  %n = arith.index_cast %c : i32 to index
  tai.parallel_for (%i) in @v {
    tai.store %zero, @v[%i] component [%n] : f32
  }
  tai.return
}

// Extents of arrays that the launch brings.
// CHECK-LABEL: tai.kernel @array(
//  CHECK-SAME:     %[[A:.+]]: memref<?xf32>, %[[B:.+]]: memref<?xf32>)
//   CHECK-DAG:   memref.dim %[[A]]
//   CHECK-DAG:   memref.dim %[[B]]
//       CHECK:   tai.precondition %{{.+}}, "index [{}] is out of range for an array of f32 of shape [{}]"
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @array(%a: memref<?xf32>, %b: memref<?xf32>) {
  %c0 = arith.constant 0 : index
  %n = memref.dim %a, %c0 : memref<?xf32>
  tai.parallel_for (%i) = (%c0) to (%n) {
    %v = memref.load %a[%i] : memref<?xf32>
    memref.store %v, %b[%i] : memref<?xf32>
  }
  tai.return
}

// The product is largest where i is m - 1: one of two iterations that are
// looked at, and the other one where n is negative.
// CHECK-LABEL: tai.kernel @product(
//  CHECK-SAME:     %[[M:.+]]: i32, %[[N:.+]]: i32)
//   CHECK-DAG:   %[[M64:.+]] = arith.extsi %[[M]] : i32 to i64
//   CHECK-DAG:   %[[N64:.+]] = arith.extsi %[[N]] : i32 to i64
//       CHECK:   %[[P:.+]] = arith.muli
//       CHECK:   tai.precondition %{{.+}}, "index [{}] is out of range for field '@x' of shape [8]"
//       CHECK:   tai.precondition %{{.+}}, "index [{}] is out of range for field '@x' of shape [8]"
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.parallel_for
tai.kernel @product(%m: i32, %n: i32) {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f32
  %to = arith.index_cast %m : i32 to index
  tai.parallel_for (%i) = (%c0) to (%to) {
    %narrow = arith.index_cast %i : index to i32
    %p = arith.muli %narrow, %n : i32
    %at = arith.index_cast %p : i32 to index
    tai.store %zero, @x[%at] : f32
  }
  tai.return
}

// A square is no corner's.
// CHECK-LABEL: tai.kernel @square(
//   CHECK-NOT:   tai.precondition
//       CHECK:   tai.return
tai.kernel @square(%m: index) {
  %c0 = arith.constant 0 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) = (%c0) to (%m) {
    %p = arith.muli %i, %i : index
    tai.store %zero, @x[%p] : f32
  }
  tai.return
}
