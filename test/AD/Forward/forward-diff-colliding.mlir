// RUN: tai-opt %s --tai-forward-diff | FileCheck %s

// A tangent comes from the iteration whose value remains. Where that is not
// decided before the loop, the iterations run in order, over the cells of a sparse
// field too.

!t = !tai.root<bitmasked<[i: 64], {h: f32, h_dual: f32}>, dense<[i: 64], {x: f32, x_dual: f32, y: f32, y_dual: f32, p: i32}>>
tai.tree @t : !t
tai.field @h_dual = @t["h_dual"] : f32, rank 1
tai.field @x_dual = @t["x_dual"] : f32, rank 1
tai.field @y_dual = @t["y_dual"] : f32, rank 1
tai.field @h = @t["h"] : f32, rank 1, dual @h_dual
tai.field @x = @t["x"] : f32, rank 1, dual @x_dual
tai.field @y = @t["y"] : f32, rank 1, dual @y_dual
tai.field @p = @t["p"] : i32, rank 1

// CHECK-LABEL: tai.kernel @known_fwd(
//       CHECK:   memref.atomic_rmw maxs
//       CHECK:   scf.if
//       CHECK:     tai.store %{{.+}}, @y[
//       CHECK:     tai.store %{{.+}}, @y_dual[
tai.kernel @known() {
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @changes_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) in @h serialize
//       CHECK:     tai.store %{{.+}}, @y[
//       CHECK:     tai.store %{{.+}}, @y_dual[
tai.kernel @changes() {
  %c2 = arith.constant 2 : index
  tai.parallel_for (%i) in @h {
    %half = arith.divsi %i, %c2 : index
    %n = arith.index_cast %i : index to i32
    tai.store %n, @p[%half] : i32
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @h[%i] : f32
    tai.store %0, @y[%j] : f32
  }
  tai.return
}

// The former value of a sum decides which iterations store.
// CHECK-LABEL: tai.kernel @by_sum_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) {{.*}}serialize
//       CHECK:     %[[OLD:.+]] = tai.atomic add
//       CHECK:     arith.cmpf ogt, %[[OLD]]
tai.kernel @by_sum() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %0 = tai.load @x[%i] : f32
    %old = tai.atomic add %0, @x[%i] : f32
    %positive = arith.cmpf ogt, %old, %zero : f32
    scf.if %positive {
      tai.store %0, @y[%j] : f32
    }
  }
  tai.return
}

// A constant is a constant, whichever iteration stores it.
// CHECK-LABEL: tai.kernel @constant_fwd(
//   CHECK-NOT:   memref.alloc
//       CHECK:   tai.return
tai.kernel @constant() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    tai.store %zero, @y[%j] : f32
  }
  tai.return
}
