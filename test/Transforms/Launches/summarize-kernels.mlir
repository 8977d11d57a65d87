// RUN: tai-opt %s --tai-summarize-kernels | FileCheck %s

// CHECK-DAG: #[[SHIFT:.+]] = affine_map<(d0)[s0] -> (s0 - 1, d0)>
// CHECK-DAG: #[[HERE:.+]] = affine_map<(d0)[s0] -> (s0, d0)>
// CHECK-DAG: #[[NONE:.+]] = affine_map<(d0)[s0] -> ()>
// CHECK-DAG: #[[NEST:.+]] = affine_map<(d0, d1) -> (d0, d0 + d1 * 2 + 1)>

!t = !tai.root<dense<[i: 8, j: 16], {x: f32, n: i32}>, {loss: f32}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 2
tai.field @n = @t["n"] : i32, rank 2
tai.field @loss = @t["loss"] : f32, rank 0

// Loop indices are dimensions, integer arguments symbols; each distinct use is
// listed once.
// CHECK:      tai.kernel @step(%{{.+}}: f32, %{{.+}}: i32)
// CHECK-SAME: summary = [#tai.access<read @x, #[[SHIFT]]>, #tai.access<write @x, #[[HERE]]>, #tai.access<accumulate @loss, #[[NONE]]>]
tai.kernel @step(%a: f32, %t: i32) {
  %c0 = arith.constant 0 : index
  %c16 = arith.constant 16 : index
  %c1 = arith.constant 1 : i32
  %before = arith.subi %t, %c1 : i32
  %s = arith.index_cast %before : i32 to index
  %u = arith.index_cast %t : i32 to index
  tai.parallel_for (%j) = (%c0) to (%c16) {
    %0 = tai.load @x[%s, %j] : f32
    %1 = tai.load @x[%s, %j] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @x[%u, %j] : f32
    tai.atomic add %2, @loss[] : f32
  }
  tai.return
}

// An index read from memory has no map; an atomic that is no sum, or whose old
// value is used, reads too.
// CHECK:      tai.kernel @indirect()
// CHECK-SAME: summary = [#tai.access<read @n, #{{.+}}>, #tai.access<read @x>, #tai.access<write @x>, #tai.access<read @n>, #tai.access<accumulate @n>]
tai.kernel @indirect() {
  tai.parallel_for (%i, %j) in @x {
    %0 = tai.load @n[%i, %j] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = arith.sitofp %0 : i32 to f32
    tai.atomic max %2, @x[%i, %1] : f32
    %3 = tai.atomic add %0, @n[%i, %1] : i32
    %4 = arith.sitofp %3 : i32 to f32
    tai.store %4, @x[%i, %1] : f32
  }
  tai.return
}

// Dimensions go from the outermost loop to the innermost, serial ones included.
// CHECK:      tai.kernel @nest()
// CHECK-SAME: summary = [#tai.access<read @x, #[[NEST]]>]
tai.kernel @nest() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) = (%c0) to (%c4) {
    scf.for %j = %c0 to %c4 step %c1 {
      %0 = arith.muli %j, %c2 : index
      %1 = arith.addi %0, %i : index
      %2 = arith.addi %1, %c1 : index
      %3 = tai.load @x[%i, %2] : f32
      tai.print "{}"(%3) : f32
    }
  }
  tai.return
}
