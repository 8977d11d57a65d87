// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s

!t = !tai.root<dense<[i: 16], {x: f32, x_grad: f32, y: f32, y_grad: f32, n: i32, next: i32}>, {a: f32, a_grad: f32}>
tai.tree @t : !t
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @a_grad = @t["a_grad"] : f32, rank 0
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad
tai.field @a = @t["a"] : f32, rank 0, adjoint @a_grad
tai.field @n = @t["n"] : i32, rank 1
tai.field @next = @t["next"] : i32, rank 1

// A branch that stays is mirrored. The contributions of its arms to values from
// outside leave it as results; the arm without one yields zero.
// CHECK-LABEL: tai.kernel @branch_grad(
//       CHECK:   %[[X:.+]] = tai.load @x
//       CHECK:   %[[C:.+]] = arith.cmpf
//       CHECK:   %[[G:.+]] = tai.load @y_grad
//       CHECK:   %[[GX:.+]] = scf.if %[[C]] -> (f32) {
//       CHECK:     %[[D:.+]] = arith.divf %[[G]], %[[X]]
//       CHECK:     scf.yield
//       CHECK:   } else {
//       CHECK:     scf.yield %{{.+}} : f32
//       CHECK:   }
//       CHECK:   tai.atomic add %[[GX]], @x_grad
tai.kernel @branch() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %c = arith.cmpf ogt, %x, %zero : f32
    %r = scf.if %c -> (f32) {
      %l = math.log %x : f32
      scf.yield %l : f32
    } else {
      scf.yield %zero : f32
    }
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// Accesses under a condition stay under it.
// CHECK-LABEL: tai.kernel @access_in_branch_grad(
//       CHECK:   scf.if
//       CHECK:     tai.load @y_grad
//       CHECK:     tai.atomic add %{{.+}}, @x_grad
//   CHECK-NOT:   else
tai.kernel @access_in_branch(%c: i1) {
  tai.parallel_for (%i) in @x {
    scf.if %c {
      %x = tai.load @x[%i] : f32
      tai.atomic add %x, @y[%i] : f32
    }
  }
  tai.return
}

// A sum is linear: its loop runs backwards once, and keeps no history.
// CHECK-LABEL: tai.kernel @sum_grad(
//   CHECK-NOT:   memref.alloc
//       CHECK:   %[[G:.+]] = tai.load @y_grad
//       CHECK:   scf.for %[[K:.+]] = %{{.+}} to %[[N:.+]] step
//       CHECK:     %[[J:.+]] = arith.subi %{{.+}}, %[[K]]
//       CHECK:     %[[X:.+]] = tai.load @x[%[[J]]]
//       CHECK:     %[[COS:.+]] = math.cos %[[X]]
//       CHECK:     %[[GX:.+]] = arith.mulf %[[G]], %[[COS]]
//       CHECK:     tai.atomic add %[[GX]], @x_grad[%[[J]]]
tai.kernel @sum(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @y {
    %s = scf.for %j = %c0 to %n step %c1 iter_args(%v = %zero) -> f32 {
      %x = tai.load @x[%j] : f32
      %w = math.sin %x : f32
      %u = arith.addf %v, %w : f32
      scf.yield %u : f32
    }
    tai.store %s, @y[%i] : f32
  }
  tai.return
}

// Bounds and step other than 0 and 1: iteration k of the reverse is iteration
// n - 1 - k of the loop.
// CHECK-LABEL: tai.kernel @steps_grad(
//  CHECK-SAME:     %[[A:.+]]: index, %[[B:.+]]: index)
//   CHECK-DAG:   %[[C3:.+]] = arith.constant 3 : index
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//       CHECK:   %[[END:.+]] = arith.maxsi %[[B]], %[[A]]
//       CHECK:   %[[DIFF:.+]] = arith.subi %[[END]], %[[A]]
//       CHECK:   %[[N:.+]] = arith.ceildivui %[[DIFF]], %[[C3]]
//       CHECK:   scf.for %[[K:.+]] = %{{.+}} to %[[N]] step %[[C1]]
//       CHECK:     %[[ORDINAL:.+]] = arith.subi %{{.+}}, %[[K]]
//       CHECK:     %[[SCALED:.+]] = arith.muli %[[ORDINAL]], %[[C3]]
//       CHECK:     %[[J:.+]] = arith.addi %[[A]], %[[SCALED]]
//       CHECK:     tai.atomic add %{{.+}}, @x_grad[%[[J]]]
tai.kernel @steps(%a: index, %b: index) {
  %c3 = arith.constant 3 : index
  scf.for %j = %a to %b step %c3 {
    %x = tai.load @x[%j] : f32
    tai.atomic add %x, @y[%j] : f32
  }
  tai.return
}

// A while loop that carries integers alone is repeated as it is.
// CHECK-LABEL: tai.kernel @list_grad(
//       CHECK:   scf.while (%[[AT:.+]] = %{{.+}}) : (i32) -> i32 {
//       CHECK:     scf.condition
//       CHECK:   } do {
//       CHECK:     %[[NEXT:.+]] = tai.load @next
//       CHECK:     tai.atomic add %{{.+}}, @x_grad
//       CHECK:     scf.yield %[[NEXT]]
tai.kernel @list() {
  %zero = arith.constant 0 : i32
  tai.parallel_for (%i) in @y {
    %k = arith.index_cast %i : index to i32
    %end = scf.while (%at = %k) : (i32) -> i32 {
      %more = arith.cmpi sgt, %at, %zero : i32
      scf.condition(%more) %at : i32
    } do {
    ^bb0(%at: i32):
      %j = arith.index_cast %at : i32 to index
      %x = tai.load @x[%j] : f32
      tai.atomic add %x, @y[%i] : f32
      %n = tai.load @next[%j] : i32
      scf.yield %n : i32
    }
  }
  tai.return
}

// The adjoint of a value read at the top level is added inside the loop.
// CHECK-LABEL: tai.kernel @captured_grad(
//       CHECK:   %[[A:.+]] = tai.load @a[]
//       CHECK:   tai.parallel_for
//       CHECK:     %[[COS:.+]] = math.cos %[[A]]
//       CHECK:     %[[GA:.+]] = arith.mulf %{{.+}}, %[[COS]]
//       CHECK:     tai.atomic add %[[GA]], @a_grad[] : f32
tai.kernel @captured() {
  %a = tai.load @a[] : f32
  %s = math.sin %a : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %p = arith.mulf %x, %s : f32
    tai.store %p, @y[%i] : f32
  }
  tai.return
}

// An ordered loop is reversed in order.
// CHECK-LABEL: tai.kernel @serialized_grad(
//  CHECK-SAME:     %[[LOW:.+]]: index, %[[HIGH:.+]]: index)
//   CHECK-DAG:   %[[ONE:.+]] = arith.constant 1 : index
//       CHECK:   tai.parallel_for (%[[K:.+]]) = (%[[LOW]]) to (%[[HIGH]]) serialize {
//       CHECK:     %[[SUM:.+]] = arith.addi %[[LOW]], %[[HIGH]]
//       CHECK:     %[[LAST:.+]] = arith.subi %[[SUM]], %[[ONE]]
//       CHECK:     %[[I:.+]] = arith.subi %[[LAST]], %[[K]]
//       CHECK:     tai.load @x_grad[%[[I]]]
tai.kernel @serialized(%low: index, %high: index) {
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) = (%low) to (%high) serialize {
    %j = arith.subi %i, %c1 : index
    %x = tai.load @x[%j] : f32
    %s = math.sin %x : f32
    tai.store %s, @x[%i] : f32
  }
  tai.return
}
