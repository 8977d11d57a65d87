// RUN: tai-opt %s --tai-scatter-to-gather --canonicalize --cse --split-input-file | FileCheck %s
// RUN: tai-opt %s --tai-scatter-to-gather=pair-sums=false --canonicalize --cse --split-input-file \
// RUN:   | FileCheck %s --check-prefix=SINGLE

tai.tree @t : !tai.root<dense<[i: 2, j: 8], {g: f32, y: f32}>>
tai.field @g = @t["g"] : f32, rank 2
tai.field @y = @t["y"] : f32, rank 2

// The adjoint of y[t, i] = x[t, (i + 1) % 8] + x[t, (i - 1) % 8]: element i gets
// what iterations i - 1 and i + 1 would have added, around the end.
// CHECK-LABEL: tai.kernel @ring(
//  CHECK-SAME:     %[[T:.+]]: index)
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//   CHECK-DAG:   %[[C7:.+]] = arith.constant 7 : index
//   CHECK-DAG:   %[[CM1:.+]] = arith.constant -1 : index
//   CHECK-DAG:   %[[C8:.+]] = arith.constant 8 : index
//   CHECK-DAG:   %[[CM7:.+]] = arith.constant -7 : index
//       CHECK:   tai.parallel_for (%[[I:.+]]) = (%[[C0]]) to (%[[C8]]) {
//  CHECK-NEXT:     %[[D:.+]] = arith.addi %[[I]], %[[CM1]]
//  CHECK-NEXT:     %[[DO:.+]] = arith.cmpi slt, %[[D]], %[[C0]]
//  CHECK-NEXT:     %[[DW:.+]] = arith.addi %[[I]], %[[C7]]
//  CHECK-NEXT:     %[[DI:.+]] = arith.select %[[DO]], %[[DW]], %[[D]]
//  CHECK-NEXT:     %[[A:.+]] = tai.load @y[%[[T]], %[[DI]]]
//  CHECK-NEXT:     %[[U:.+]] = arith.addi %[[I]], %[[C1]]
//  CHECK-NEXT:     %[[UO:.+]] = arith.cmpi sge, %[[U]], %[[C8]]
//  CHECK-NEXT:     %[[UW:.+]] = arith.addi %[[I]], %[[CM7]]
//  CHECK-NEXT:     %[[UI:.+]] = arith.select %[[UO]], %[[UW]], %[[U]]
//  CHECK-NEXT:     %[[B:.+]] = tai.load @y[%[[T]], %[[UI]]]
//  CHECK-NEXT:     %[[S:.+]] = arith.addf %[[A]], %[[B]]
//  CHECK-NEXT:     tai.atomic add %[[S]], @g[%[[T]], %[[I]]] exclusive
//  CHECK-NEXT:   }
tai.kernel @ring(%t: index) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%c8) {
    %c1_i32 = arith.constant 1 : i32
    %c8_i32 = arith.constant 8 : i32
    %c0_i32 = arith.constant 0 : i32
    %0 = tai.load @y[%t, %i] : f32
    %i_i32 = arith.index_cast %i : index to i32
    %up = arith.addi %i_i32, %c1_i32 : i32
    %up_r = arith.remsi %up, %c8_i32 : i32
    %up_i = arith.index_cast %up_r : i32 to index
    %1 = tai.atomic add %0, @g[%t, %up_i] : f32
    %down = arith.subi %i_i32, %c1_i32 : i32
    %down_r = arith.remsi %down, %c8_i32 : i32
    %neg = arith.cmpi slt, %down_r, %c0_i32 : i32
    %down_w = arith.addi %down_r, %c8_i32 : i32
    %down_m = arith.select %neg, %down_w, %down_r : i32
    %down_i = arith.index_cast %down_m : i32 to index
    %2 = tai.atomic add %0, @g[%t, %down_i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 3, j: 8], {g: f32}>>
tai.field @g = @t["g"] : f32, rank 2

// Conditions move along; terms outside the loop are left out. Two slices of one
// field are two groups, read a third.
// CHECK-LABEL: tai.kernel @cut_off(
//       CHECK:   tai.parallel_for (%[[I:.+]]) =
//       CHECK:     scf.if
//       CHECK:       tai.load @g[%{{.+}}, %{{.+}}]
//       CHECK:     tai.atomic add %{{.+}}, @g[%{{.+}}, %[[I]]] exclusive
//       CHECK:     tai.atomic add %{{.+}}, @g[%{{.+}}, %[[I]]] exclusive
//   CHECK-NOT:     tai.atomic
tai.kernel @cut_off(%t: i32) {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  %c7 = arith.constant 7 : index
  %c1 = arith.constant 1 : index
  %c1_i32 = arith.constant 1 : i32
  %c2_i32 = arith.constant 2 : i32
  %slot = arith.index_cast %t : i32 to index
  tai.parallel_for (%i) = (%c0) to (%c8) {
    %before = arith.subi %t, %c1_i32 : i32
    %before_i = arith.index_cast %before : i32 to index
    %long = arith.subi %t, %c2_i32 : i32
    %long_i = arith.index_cast %long : i32 to index
    %0 = tai.load @g[%slot, %i] : f32
    %inside = arith.cmpi slt, %i, %c7 : index
    scf.if %inside {
      %up = arith.addi %i, %c1 : index
      %1 = tai.atomic add %0, @g[%before_i, %up] : f32
    }
    %2 = tai.atomic add %0, @g[%before_i, %i] : f32
    %3 = tai.atomic add %0, @g[%long_i, %i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {g: f32, y: f32, h: f32}>>
tai.field @g = @t["g"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @h = @t["h"] : f32, rank 1

// Plain additions come last, behind all that is read.
// CHECK-LABEL: tai.kernel @sink(
//       CHECK:   tai.load
//       CHECK:   tai.load
//  CHECK-NEXT:   tai.atomic add %{{.+}}, @h[%[[I:.+]]] exclusive
//  CHECK-NEXT:   tai.atomic add %{{.+}}, @g[%[[I]]] exclusive
tai.kernel @sink() {
  %c8 = arith.constant 8 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @g {
    %0 = tai.load @y[%i] : f32
    %1 = tai.atomic add %0, @h[%i] exclusive : f32
    %up = arith.addi %i, %c1 : index
    %wrapped = arith.remui %up, %c8 : index
    %2 = tai.atomic add %0, @g[%wrapped] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {g: f32, y: f32, p: i32, h: f32}>, dense<[i: 10], {longer: f32}>,
                        dense<[i: 4, j: 4], {m: f32}>, {s: f32}>
tai.field @g = @t["g"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @h = @t["h"] : f32, rank 1
tai.field @longer = @t["longer"] : f32, rank 1
tai.field @p = @t["p"] : i32, rank 1
tai.field @m = @t["m"] : f32, rank 2

// An index that is read from memory has no inverse.
// CHECK-LABEL: tai.kernel @data_dependent(
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @data_dependent(%f: f32) {
  tai.parallel_for (%i) in @g {
    %0 = tai.load @p[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.atomic add %f, @g[%1] : f32
  }
  tai.return
}

// Many iterations add to one element: a reduction, not a scatter.
// CHECK-LABEL: tai.kernel @reduction(
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @reduction(%f: f32) {
  tai.parallel_for (%i, %j) in @m {
    %0 = tai.atomic add %f, @g[%i] : f32
  }
  tai.return
}

// The loop covers little of the field: all of it would be too much.
// CHECK-LABEL: tai.kernel @partial(
//       CHECK:   tai.parallel_for (%{{.+}}) = (%{{.+}}) to (%c3) {
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @partial(%f: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) = (%c0) to (%c3) {
    %up = arith.addi %i, %c1 : index
    %0 = tai.atomic add %f, @g[%up] : f32
  }
  tai.return
}

// Nearly all of the field: the loop is over all of it, and its own iterations
// store. Element i gets what iterations i - 1 and i + 1 would have added, where
// they are in [1, 7).
// CHECK-LABEL: tai.kernel @inner(
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//   CHECK-DAG:   %[[CM1:.+]] = arith.constant -1 : index
//   CHECK-DAG:   %[[C7:.+]] = arith.constant 7 : index
//   CHECK-DAG:   %[[C8:.+]] = arith.constant 8 : index
//       CHECK:   tai.parallel_for (%[[I:.+]]) = (%[[C0]]) to (%[[C8]]) {
//   CHECK-DAG:     %[[A:.+]] = arith.cmpi sge, %[[I]], %[[C1]]
//   CHECK-DAG:     %[[B:.+]] = arith.cmpi slt, %[[I]], %[[C7]]
//       CHECK:     %[[OWN:.+]] = arith.andi %[[A]], %[[B]]
//       CHECK:     scf.if %[[OWN]] {
//       CHECK:       tai.store %{{.+}}, @h[%[[I]]]
//       CHECK:     }
//       CHECK:     %[[D:.+]] = arith.addi %[[I]], %[[CM1]]
//       CHECK:     %[[DL:.+]] = arith.cmpi sge, %[[D]], %[[C1]]
//   CHECK-NOT:     arith.cmpi
//       CHECK:     scf.if %[[DL]]
//       CHECK:       tai.load @y[%[[D]]]
//       CHECK:     %[[U:.+]] = arith.addi %[[I]], %[[C1]]
//       CHECK:     %[[UL:.+]] = arith.cmpi slt, %[[U]], %[[C7]]
//   CHECK-NOT:     arith.cmpi
//       CHECK:     scf.if %[[UL]]
//       CHECK:       tai.load @y[%[[U]]]
//       CHECK:     tai.atomic add %{{.+}}, @g[%[[I]]] exclusive
//   CHECK-NOT:     tai.atomic
tai.kernel @inner(%f: f32) {
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  tai.parallel_for (%i) = (%c1) to (%c7) {
    tai.store %f, @h[%i] : f32
    %0 = tai.load @y[%i] : f32
    %up = arith.addi %i, %c1 : index
    %1 = tai.atomic add %0, @g[%up] : f32
    %down = arith.subi %i, %c1 : index
    %2 = tai.atomic add %0, @g[%down] : f32
  }
  tai.return
}

// An index that wraps around the range of the loop stays inside of it.
// CHECK-LABEL: tai.kernel @inner_ring(
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//   CHECK-DAG:   %[[C7:.+]] = arith.constant 7 : index
//       CHECK:   tai.parallel_for (%[[I:.+]]) =
//   CHECK-DAG:     %[[A:.+]] = arith.cmpi sge, %[[I]], %[[C1]]
//   CHECK-DAG:     %[[B:.+]] = arith.cmpi slt, %[[I]], %[[C7]]
//       CHECK:     %[[OWN:.+]] = arith.andi %[[A]], %[[B]]
//       CHECK:     scf.if %[[OWN]]
//       CHECK:     tai.atomic add %{{.+}}, @g[%[[I]]] exclusive
tai.kernel @inner_ring() {
  %c1 = arith.constant 1 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  tai.parallel_for (%i) = (%c1) to (%c7) {
    %0 = tai.load @y[%i] : f32
    // i + 1, and 1 after 6.
    %turned = arith.remui %i, %c6 : index
    %next = arith.addi %turned, %c1 : index
    %1 = tai.atomic add %0, @g[%next] : f32
  }
  tai.return
}

// Random numbers are those of positions in the box, which does not change.
// CHECK-LABEL: tai.kernel @inner_random(
//       CHECK:   tai.parallel_for (%{{.+}}) = (%c1) to (%c7) {
//       CHECK:     tai.random
//       CHECK:     tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @inner_random() {
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  tai.parallel_for (%i) = (%c1) to (%c7) {
    %0 = tai.random stream 0 : f32
    tai.store %0, @h[%i] : f32
    %1 = tai.load @y[%i] : f32
    %up = arith.addi %i, %c1 : index
    %2 = tai.atomic add %1, @g[%up] : f32
  }
  tai.return
}

// Fields of two sizes: the loop cannot be over both.
// CHECK-LABEL: tai.kernel @two_sizes(
//       CHECK:   tai.atomic add %{{.+}}, @longer[%{{.+}}] : f32
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] exclusive
tai.kernel @two_sizes() {
  %c1 = arith.constant 1 : index
  %c7 = arith.constant 7 : index
  tai.parallel_for (%i) = (%c1) to (%c7) {
    %0 = tai.load @y[%i] : f32
    %up = arith.addi %i, %c1 : index
    %1 = tai.atomic add %0, @g[%up] : f32
    %2 = tai.atomic add %0, @longer[%up] : f32
  }
  tai.return
}

// The term is read from a field that the loop writes.
// CHECK-LABEL: tai.kernel @written(
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @written(%f: f32) {
  %c8 = arith.constant 8 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @g {
    %0 = tai.load @h[%i] : f32
    tai.store %f, @h[%i] : f32
    %up = arith.addi %i, %c1 : index
    %wrapped = arith.remui %up, %c8 : index
    %1 = tai.atomic add %0, @g[%wrapped] : f32
  }
  tai.return
}

// The field is read where it is added to.
// CHECK-LABEL: tai.kernel @read_back(
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @read_back() {
  %c8 = arith.constant 8 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @g {
    %0 = tai.load @g[%i] : f32
    %up = arith.addi %i, %c1 : index
    %wrapped = arith.remui %up, %c8 : index
    %1 = tai.atomic add %0, @g[%wrapped] : f32
  }
  tai.return
}

// A random number cannot be drawn again elsewhere.
// CHECK-LABEL: tai.kernel @random(
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @random() {
  %c8 = arith.constant 8 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @g {
    %0 = tai.random stream 0 : f32
    %up = arith.addi %i, %c1 : index
    %wrapped = arith.remui %up, %c8 : index
    %1 = tai.atomic add %0, @g[%wrapped] : f32
  }
  tai.return
}

// The map must be a shift: this one visits some elements twice.
// CHECK-LABEL: tai.kernel @halves(
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @halves(%f: f32) {
  %c2 = arith.constant 2 : index
  tai.parallel_for (%i) in @g {
    %0 = arith.divsi %i, %c2 : index
    %1 = tai.atomic add %f, @g[%0] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 64], {g: f64, h: f32, y: f64, z: f32}>>
tai.field @g = @t["g"] : f64, rank 1
tai.field @h = @t["h"] : f32, rank 1
tai.field @y = @t["y"] : f64, rank 1
tai.field @z = @t["z"] : f32, rank 1

// Compensated: of f32 in f64; of f64 the rounding error of the sum is added to
// it at the end, unless the sum is infinite.
// CHECK-LABEL: tai.kernel @compensated(
//       CHECK:     %[[B:.+]] = tai.load @y
//       CHECK:     %[[C:.+]] = tai.load @y
//  CHECK-NEXT:     %[[S:.+]] = arith.addf %[[B]], %[[C]] : f64
//  CHECK-NEXT:     %[[T:.+]] = arith.subf %[[S]], %[[B]]
//  CHECK-NEXT:     %[[BB:.+]] = arith.subf %[[S]], %[[T]]
//  CHECK-NEXT:     %[[E:.+]] = arith.subf %[[B]], %[[BB]]
//  CHECK-NEXT:     %[[F:.+]] = arith.subf %[[C]], %[[T]]
//  CHECK-NEXT:     %[[R:.+]] = arith.addf %[[E]], %[[F]]
//  CHECK-NEXT:     %[[O:.+]] = arith.cmpf ord, %[[R]], %[[R]]
//  CHECK-NEXT:     %[[U:.+]] = arith.addf %[[S]], %[[R]]
//  CHECK-NEXT:     %[[V:.+]] = arith.select %[[O]], %[[U]], %[[S]]
//       CHECK:     arith.extf
//       CHECK:     arith.extf
//       CHECK:     %[[W:.+]] = arith.addf %{{.+}}, %{{.+}} : f64
//       CHECK:     %[[N:.+]] = arith.truncf %[[W]] : f64 to f32
//   CHECK-DAG:     tai.atomic add %[[V]], @g[%{{.+}}] exclusive
//   CHECK-DAG:     tai.atomic add %[[N]], @h[%{{.+}}] exclusive
// Additions of f64 stay where products are fused with several additions.
// SINGLE-LABEL: tai.kernel @compensated(
//   SINGLE-DAG:     tai.atomic add %{{.+}}, @h[%{{.+}}] exclusive
//   SINGLE-DAG:     tai.atomic add %{{.+}}, @g[%{{.+}}] : f64
tai.kernel @compensated() attributes {modes = {sums = "compensated"}} {
  %c1 = arith.constant 1 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) in @y {
    %a = tai.load @y[%i] : f64
    %b = tai.load @z[%i] : f32
    %j = arith.addi %i, %c1 : index
    %k = arith.remui %j, %c64 : index
    %0 = tai.atomic add %a, @g[%i] : f64
    %1 = tai.atomic add %a, @g[%k] : f64
    %2 = tai.atomic add %b, @h[%i] : f32
    %3 = tai.atomic add %b, @h[%k] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 70000], {g: f32, y: f32}>>
tai.field @g = @t["g"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1

// The last iteration adds to the element of the last but one: to the last
// element it adds once more than the shift does.
// CHECK-LABEL: tai.kernel @clamped(
//   CHECK-DAG:   %[[LAST:.+]] = arith.constant 69999 : index
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @g
//       CHECK:     %[[BEFORE:.+]] = arith.addi %[[I]], %{{.+}} : index
//       CHECK:     scf.if
//       CHECK:       tai.load @y[%[[BEFORE]]]
//       CHECK:     arith.cmpi eq, %[[I]], %{{.+}} : index
//       CHECK:     scf.if
//       CHECK:       tai.load @y[%{{.+}}]
//       CHECK:     tai.atomic add %{{.+}}, @g[%[[I]]] exclusive
tai.kernel @clamped() {
  %c1 = arith.constant 1 : index
  %last = arith.constant 69999 : index
  tai.parallel_for (%i) in @g {
    %0 = tai.load @y[%i] : f32
    %1 = arith.addi %i, %c1 : index
    %2 = arith.minsi %1, %last : index
    %3 = tai.atomic add %0, @g[%2] : f32
  }
  tai.return
}

// Half of the iterations add to the first element.
// CHECK-LABEL: tai.kernel @clamped_by_half(
//       CHECK:   tai.atomic add %{{.+}}, @g[%{{.+}}] : f32
tai.kernel @clamped_by_half() {
  %c0 = arith.constant 0 : index
  %half = arith.constant 35000 : index
  tai.parallel_for (%i) in @g {
    %0 = tai.load @y[%i] : f32
    %1 = arith.subi %i, %half : index
    %2 = arith.maxsi %1, %c0 : index
    %3 = tai.atomic add %0, @g[%2] : f32
  }
  tai.return
}
