// Additions that differ in constant indices alone become iterations of their
// own, in front of those of the loop, which fill whole warps.
// RUN: tai-opt %s --tai-reroll-accumulations=min-additions=4 --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-reroll-accumulations=min-additions=30 | FileCheck %s --check-prefix=FEW
// RUN: tai-opt %s --tai-reroll-accumulations="min-additions=4 max-iterations=61" | FileCheck %s --check-prefix=FEW

// FEW-NOT: tai.parallel_for (%{{[a-z0-9]*}}, %

tai.tree @t : !tai.root<dense<[i: 62], {g: f32, s: f32, u: f32}>, dense<[j: 12], {x: f32, y: f32, dx: f32, dy: f32}>, dense<[i: 62], dense<[j: 12], {w: f32, dw: f32}>>, {c: f32}>
tai.field @g = @t["g"] : f32, rank 1
tai.field @s = @t["s"] : f32, rank 1
tai.field @u = @t["u"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1
tai.field @y = @t["y"] : f32, rank 1
tai.field @dx = @t["dx"] : f32, rank 1
tai.field @dy = @t["dy"] : f32, rank 1
tai.field @w = @t["w"] : f32, rank 2
tai.field @dw = @t["dw"] : f32, rank 2
tai.field @c = @t["c"] : f32, rank 0

// A layer of five inputs, and one addition that is like no other.
// CHECK-LABEL: tai.kernel @layer
// CHECK:       tai.parallel_for (%[[M:.*]], %[[I:.*]]) = (%c0, %c0) to (%c6, %c64) block_dim 64 {
// CHECK:         %[[INSIDE:.*]] = arith.cmpi slt, %[[I]], %c62
// CHECK:         scf.if %[[INSIDE]]
// CHECK:           %[[ALIKE:.*]] = arith.cmpi slt, %[[M]], %c5
// CHECK:           scf.if %[[ALIKE]] {
// CHECK-DAG:         %[[G:.*]] = tai.load @g[%[[I]]]
// CHECK-DAG:         %[[X:.*]] = tai.load @x[%[[M]]]
// CHECK-DAG:         %[[W:.*]] = tai.load @w[%[[I]], %[[M]]]
// CHECK-DAG:         %[[P:.*]] = arith.mulf %[[G]], %[[X]]
// CHECK-DAG:         %[[Q:.*]] = arith.mulf %[[G]], %[[W]]
// CHECK:             tai.atomic add %[[P]], @dw[%[[I]], %[[M]]] exclusive
// CHECK-NEXT:        tai.atomic add %[[Q]], @dx[%[[M]]]
// CHECK-NEXT:      } else {
// CHECK-NEXT:        %[[AGAIN:.*]] = tai.load @g[%[[I]]]
// CHECK-NEXT:        tai.atomic add %[[AGAIN]], @s[%[[I]]] exclusive
// CHECK-NEXT:      }
// CHECK-NOT:       tai.atomic
tai.kernel @layer() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) block_dim 64 {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
    %w4 = tai.load @w[%i, %c4] : f32
    %x4 = tai.load @x[%c4] : f32
    %p4 = arith.mulf %g, %x4 : f32
    %q4 = arith.mulf %g, %w4 : f32
    %a4 = tai.atomic add %p4, @dw[%i, %c4] exclusive : f32
    %b4 = tai.atomic add %q4, @dx[%c4] : f32
    %o = tai.atomic add %g, @s[%i] exclusive : f32
  }
  tai.return
}

// Steps of any size, downwards too; two series of two lengths.
// CHECK-LABEL: tai.kernel @steps
// CHECK:       tai.parallel_for (%[[M:.*]], %[[I:.*]]) = (%c0, %c0) to (%c6, %c64)
// CHECK:         %[[DOWN:.*]] = arith.muli %[[M]], %c-2
// CHECK:         %[[AT:.*]] = arith.addi %[[DOWN]], %c11
// CHECK:         tai.atomic add %{{.*}}, @dx[%[[AT]]]
// CHECK:         %[[FEWER:.*]] = arith.cmpi slt, %[[M]], %c4
// CHECK:         scf.if %[[FEWER]]
// CHECK:           tai.atomic sub %{{.*}}, @dy[%[[M]]]
tai.kernel @steps() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %b11 = tai.atomic add %g, @dx[%c11] : f32
    %b9 = tai.atomic add %g, @dx[%c9] : f32
    %b7 = tai.atomic add %g, @dx[%c7] : f32
    %b5 = tai.atomic add %g, @dx[%c5] : f32
    %b3 = tai.atomic add %g, @dx[%c3] : f32
    %b1 = tai.atomic add %g, @dx[%c1] : f32
    %d0 = tai.atomic sub %g, @dy[%c0] : f32
    %d1 = tai.atomic sub %g, @dy[%c1] : f32
    %d2 = tai.atomic sub %g, @dy[%c2] : f32
    %d3 = tai.atomic sub %g, @dy[%c3] : f32
  }
  tai.return
}

// More iterations than threads: each has two, of even and of odd indices.
// CHECK-LABEL: tai.kernel @several
// CHECK:       tai.parallel_for (%[[M:.*]], %[[I:.*]]) = (%c0, %c0) to (%c6, %c64)
// CHECK-DAG:     %[[EVEN:.*]] = arith.muli %[[M]], %c2
// CHECK-DAG:     %[[ODD:.*]] = arith.addi %[[EVEN]], %c1
// CHECK-DAG:     %[[X:.*]] = tai.load @x[%[[EVEN]]]
// CHECK-DAG:     %[[Y:.*]] = tai.load @x[%[[ODD]]]
// CHECK-DAG:     %[[P:.*]] = arith.mulf %{{.*}}, %[[X]]
// CHECK-DAG:     %[[Q:.*]] = arith.mulf %{{.*}}, %[[Y]]
// CHECK:         tai.atomic add %[[P]], @dw[%[[I]], %[[EVEN]]] exclusive
// CHECK-NEXT:    tai.atomic add %[[Q]], @dw[%[[I]], %[[ODD]]] exclusive
// CHECK-NEXT:    tai.atomic add %{{.*}}, @dx[%[[EVEN]]]
// CHECK-NEXT:    tai.atomic add %{{.*}}, @dx[%[[ODD]]]
// CHECK-NOT:     tai.atomic
tai.kernel @several() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
    %w4 = tai.load @w[%i, %c4] : f32
    %x4 = tai.load @x[%c4] : f32
    %p4 = arith.mulf %g, %x4 : f32
    %q4 = arith.mulf %g, %w4 : f32
    %a4 = tai.atomic add %p4, @dw[%i, %c4] exclusive : f32
    %b4 = tai.atomic add %q4, @dx[%c4] : f32
    %w5 = tai.load @w[%i, %c5] : f32
    %x5 = tai.load @x[%c5] : f32
    %p5 = arith.mulf %g, %x5 : f32
    %q5 = arith.mulf %g, %w5 : f32
    %a5 = tai.atomic add %p5, @dw[%i, %c5] exclusive : f32
    %b5 = tai.atomic add %q5, @dx[%c5] : f32
    %w6 = tai.load @w[%i, %c6] : f32
    %x6 = tai.load @x[%c6] : f32
    %p6 = arith.mulf %g, %x6 : f32
    %q6 = arith.mulf %g, %w6 : f32
    %a6 = tai.atomic add %p6, @dw[%i, %c6] exclusive : f32
    %b6 = tai.atomic add %q6, @dx[%c6] : f32
    %w7 = tai.load @w[%i, %c7] : f32
    %x7 = tai.load @x[%c7] : f32
    %p7 = arith.mulf %g, %x7 : f32
    %q7 = arith.mulf %g, %w7 : f32
    %a7 = tai.atomic add %p7, @dw[%i, %c7] exclusive : f32
    %b7 = tai.atomic add %q7, @dx[%c7] : f32
    %w8 = tai.load @w[%i, %c8] : f32
    %x8 = tai.load @x[%c8] : f32
    %p8 = arith.mulf %g, %x8 : f32
    %q8 = arith.mulf %g, %w8 : f32
    %a8 = tai.atomic add %p8, @dw[%i, %c8] exclusive : f32
    %b8 = tai.atomic add %q8, @dx[%c8] : f32
    %w9 = tai.load @w[%i, %c9] : f32
    %x9 = tai.load @x[%c9] : f32
    %p9 = arith.mulf %g, %x9 : f32
    %q9 = arith.mulf %g, %w9 : f32
    %a9 = tai.atomic add %p9, @dw[%i, %c9] exclusive : f32
    %b9 = tai.atomic add %q9, @dx[%c9] : f32
    %w10 = tai.load @w[%i, %c10] : f32
    %x10 = tai.load @x[%c10] : f32
    %p10 = arith.mulf %g, %x10 : f32
    %q10 = arith.mulf %g, %w10 : f32
    %a10 = tai.atomic add %p10, @dw[%i, %c10] exclusive : f32
    %b10 = tai.atomic add %q10, @dx[%c10] : f32
    %w11 = tai.load @w[%i, %c11] : f32
    %x11 = tai.load @x[%c11] : f32
    %p11 = arith.mulf %g, %x11 : f32
    %q11 = arith.mulf %g, %w11 : f32
    %a11 = tai.atomic add %p11, @dw[%i, %c11] exclusive : f32
    %b11 = tai.atomic add %q11, @dx[%c11] : f32
  }
  tai.return
}

// The terms of a sum are added one by one.
// CHECK-LABEL: tai.kernel @terms
// CHECK:       tai.parallel_for (%[[M:.*]], %[[I:.*]]) = (%c0, %c0) to (%c5, %c64)
// CHECK:         %[[X:.*]] = tai.load @x[%[[M]]]
// CHECK:         %[[V:.*]] = arith.mulf %{{.*}}, %[[X]]
// CHECK:         %[[N:.*]] = arith.negf %[[V]]
// CHECK:         tai.atomic add %[[N]], @c[]
// CHECK-NOT:     tai.atomic
tai.kernel @terms() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %x0 = tai.load @x[%c0] : f32
    %v0 = arith.mulf %g, %x0 : f32
    %t0 = arith.negf %v0 : f32
    %x1 = tai.load @x[%c1] : f32
    %v1 = arith.mulf %g, %x1 : f32
    %t1 = arith.subf %t0, %v1 : f32
    %x2 = tai.load @x[%c2] : f32
    %v2 = arith.mulf %g, %x2 : f32
    %t2 = arith.subf %t1, %v2 : f32
    %x3 = tai.load @x[%c3] : f32
    %v3 = arith.mulf %g, %x3 : f32
    %t3 = arith.subf %t2, %v3 : f32
    %x4 = tai.load @x[%c4] : f32
    %v4 = arith.mulf %g, %x4 : f32
    %t4 = arith.subf %t3, %v4 : f32
    %o = tai.atomic add %t4, @c[] : f32
  }
  tai.return
}

// Uneven indices are no series, and stay together.
// CHECK-LABEL: tai.kernel @uneven
// CHECK:       tai.parallel_for (%{{[a-z0-9]*}}) =
// CHECK:         tai.return
tai.kernel @uneven() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %b0 = tai.atomic add %g, @dx[%c0] : f32
    %b1 = tai.atomic add %g, @dx[%c1] : f32
    %b3 = tai.atomic add %g, @dx[%c3] : f32
    %b7 = tai.atomic add %g, @dx[%c7] : f32
    %b4 = tai.atomic add %g, @dx[%c4] : f32
    %b11 = tai.atomic add %g, @dx[%c11] : f32
  }
  tai.return
}

// Updates of one element that are not atomic stay in one iteration.
// CHECK-LABEL: tai.kernel @same_element
// CHECK:       tai.parallel_for (%{{.*}}, %{{.*}}) =
// CHECK:         else
// CHECK:           tai.atomic add %{{.*}}, @s[%{{.*}}] exclusive
// CHECK:           tai.atomic sub %{{.*}}, @s[%{{.*}}] exclusive
// CHECK:         tai.return
tai.kernel @same_element() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
    %h = arith.mulf %g, %g : f32
    %o = tai.atomic add %g, @s[%i] exclusive : f32
    %n = tai.atomic sub %h, @s[%i] exclusive : f32
  }
  tai.return
}

// A branch with additions in it is done by the one that does the rest.
// CHECK-LABEL: tai.kernel @branch
// CHECK:       tai.parallel_for (%{{.*}}, %{{.*}}) =
// CHECK:         else
// CHECK:           scf.if
// CHECK-NEXT:        tai.atomic add %{{.*}}, @c[]
// CHECK:         tai.return
tai.kernel @branch() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
    %zero = arith.constant 0.0 : f32
    %is = arith.cmpf ogt, %g, %zero : f32
    scf.if %is {
      %o = tai.atomic add %g, @c[] : f32
    }
  }
  tai.return
}

// The updated field is read.
// CHECK-LABEL: tai.kernel @reads
// CHECK:       tai.parallel_for (%{{[a-z0-9]*}}) =
// CHECK:         tai.return
tai.kernel @reads() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
    %r = tai.load @dx[%c7] : f32
    %o = tai.atomic add %r, @s[%i] exclusive : f32
  }
  tai.return
}

// A store has its place in an order.
// CHECK-LABEL: tai.kernel @stores
// CHECK:       tai.parallel_for (%{{[a-z0-9]*}}) =
// CHECK:         tai.return
tai.kernel @stores() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
    tai.store %g, @s[%i] : f32
  }
  tai.return
}

// So has the former value.
// CHECK-LABEL: tai.kernel @takes_what_was_before
// CHECK:       tai.parallel_for (%{{[a-z0-9]*}}) =
// CHECK:         tai.return
tai.kernel @takes_what_was_before() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
    %o = tai.atomic add %g, @c[] : f32
    %r = tai.atomic add %o, @s[%i] exclusive : f32
  }
  tai.return
}

// How long a row is must be known, to make it longer.
// CHECK-LABEL: tai.kernel @unknown_length
// CHECK:       tai.parallel_for (%{{[a-z0-9]*}}) =
// CHECK:         tai.return
tai.kernel @unknown_length(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
  }
  tai.return
}

// One thread has no others to share with.
// CHECK-LABEL: tai.kernel @serial
// CHECK:       tai.parallel_for (%{{[a-z0-9]*}}) =
// CHECK:         tai.return
tai.kernel @serial() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) serialize {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
  }
  tai.return
}

// Maxima are not added.
// CHECK-LABEL: tai.kernel @maxima
// CHECK:       tai.parallel_for (%{{[a-z0-9]*}}) =
// CHECK:         tai.return
tai.kernel @maxima() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %c7 = arith.constant 7 : index
  %c8 = arith.constant 8 : index
  %c9 = arith.constant 9 : index
  %c10 = arith.constant 10 : index
  %c11 = arith.constant 11 : index
  %c62 = arith.constant 62 : index
  tai.parallel_for (%i) = (%c0) to (%c62) {
    %g = tai.load @g[%i] : f32
    %w0 = tai.load @w[%i, %c0] : f32
    %x0 = tai.load @x[%c0] : f32
    %p0 = arith.mulf %g, %x0 : f32
    %q0 = arith.mulf %g, %w0 : f32
    %a0 = tai.atomic add %p0, @dw[%i, %c0] exclusive : f32
    %b0 = tai.atomic add %q0, @dx[%c0] : f32
    %w1 = tai.load @w[%i, %c1] : f32
    %x1 = tai.load @x[%c1] : f32
    %p1 = arith.mulf %g, %x1 : f32
    %q1 = arith.mulf %g, %w1 : f32
    %a1 = tai.atomic add %p1, @dw[%i, %c1] exclusive : f32
    %b1 = tai.atomic add %q1, @dx[%c1] : f32
    %w2 = tai.load @w[%i, %c2] : f32
    %x2 = tai.load @x[%c2] : f32
    %p2 = arith.mulf %g, %x2 : f32
    %q2 = arith.mulf %g, %w2 : f32
    %a2 = tai.atomic add %p2, @dw[%i, %c2] exclusive : f32
    %b2 = tai.atomic add %q2, @dx[%c2] : f32
    %w3 = tai.load @w[%i, %c3] : f32
    %x3 = tai.load @x[%c3] : f32
    %p3 = arith.mulf %g, %x3 : f32
    %q3 = arith.mulf %g, %w3 : f32
    %a3 = tai.atomic add %p3, @dw[%i, %c3] exclusive : f32
    %b3 = tai.atomic add %q3, @dx[%c3] : f32
    %o = tai.atomic max %g, @c[] : f32
  }
  tai.return
}
