// RUN: tai-opt %s --tai-forward-diff --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-forward-diff=kernel=square | FileCheck %s --check-prefix=ONE

!t = !tai.root<dense<[i: 16], {x: f32, x_dual: f32, y: f32, y_dual: f32, c: f32, n: i32, v: vector<2xf32>, v_dual: vector<2xf32>}>, {a: f32, a_dual: f32}>
tai.tree @t : !t
tai.field @x_dual = @t["x_dual"] : f32, rank 1
tai.field @y_dual = @t["y_dual"] : f32, rank 1
tai.field @a_dual = @t["a_dual"] : f32, rank 0
tai.field @v_dual = @t["v_dual"] : vector<2xf32>, rank 1
tai.field @x = @t["x"] : f32, rank 1, dual @x_dual
tai.field @y = @t["y"] : f32, rank 1, dual @y_dual
tai.field @a = @t["a"] : f32, rank 0, dual @a_dual
tai.field @v = @t["v"] : vector<2xf32>, rank 1, dual @v_dual
tai.field @c = @t["c"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 1

// The example of the pass's page.
// ONE:       tai.kernel @square() attributes {tangent = @square_fwd}
// ONE:       tai.kernel @square_fwd
// ONE-NOT:   _fwd(
// CHECK-LABEL: tai.kernel @square_fwd() {
//  CHECK-NEXT:   tai.parallel_for (%[[I:.+]]) in @x {
//  CHECK-NEXT:     %[[X:.+]] = tai.load @x[%[[I]]] : f32
//  CHECK-NEXT:     %[[DX:.+]] = tai.load @x_dual[%[[I]]] : f32
//  CHECK-NEXT:     %[[R:.+]] = arith.mulf %[[X]], %[[X]] : f32
//  CHECK-NEXT:     %[[P:.+]] = arith.mulf %[[DX]], %[[X]] : f32
//  CHECK-NEXT:     %[[DR:.+]] = arith.addf %[[P]], %[[P]] : f32
//  CHECK-NEXT:     tai.store %[[R]], @y[%[[I]]] : f32
//  CHECK-NEXT:     tai.store %[[DR]], @y_dual[%[[I]]] : f32
tai.kernel @square() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @y[%i] : f32
  }
  tai.return
}

// A constant is stored with the tangent zero: the old one must go. A value read
// from a field without a dual is constant, and a value stored there loses its
// tangent, as in reverse mode.
// CHECK-LABEL: tai.kernel @constants_fwd(
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//       CHECK:   %[[C:.+]] = tai.load @c
//       CHECK:   tai.store %[[C]], @y
//  CHECK-NEXT:   tai.store %[[ZERO]], @y_dual
//       CHECK:   tai.store %{{.+}}, @c
//  CHECK-NEXT: }
tai.kernel @constants() {
  tai.parallel_for (%i) in @x {
    %c = tai.load @c[%i] : f32
    tai.store %c, @y[%i] : f32
    %x = tai.load @x[%i] : f32
    tai.store %x, @c[%i] : f32
  }
  tai.return
}

// Loops carry tangents behind values; discrete values have none.
// CHECK-LABEL: tai.kernel @loop_fwd(
//       CHECK:   %{{.+}}:3 = scf.for {{.*}} iter_args(%[[S:.+]] = %{{.+}}, %[[K:.+]] = %{{.+}}, %[[DS:.+]] = %{{.+}}) -> (f32, i32, f32)
//       CHECK:     math.sin %[[S]]
//       CHECK:     %[[COS:.+]] = math.cos %[[S]]
//       CHECK:     %[[NEXT:.+]] = arith.mulf %[[DS]], %[[COS]]
//       CHECK:     scf.yield %{{.+}}, %{{.+}}, %[[NEXT]]
tai.kernel @loop(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %k0 = arith.constant 0 : i32
  %k1 = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %r:2 = scf.for %j = %c0 to %n step %c1 iter_args(%s = %x, %k = %k0) -> (f32, i32) {
      %t = math.sin %s : f32
      %l = arith.addi %k, %k1 : i32
      scf.yield %t, %l : f32, i32
    }
    tai.store %r#0, @y[%i] : f32
    tai.store %r#1, @n[%i] : i32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @branches_fwd(
//       CHECK:   scf.while (%{{.+}} = %{{.+}}, %{{.+}} = %{{.+}}) : (f32, f32) -> (f32, f32)
//       CHECK:     scf.condition(%{{.+}}) %{{.+}}, %{{.+}} : f32, f32
//       CHECK:     scf.yield %{{.+}}, %{{.+}} : f32, f32
//       CHECK:   scf.if %{{.+}} -> (f32, f32)
//       CHECK:     scf.yield %{{.+}}, %{{.+}} : f32, f32
//       CHECK:     scf.yield %{{.+}}, %{{.+}} : f32, f32
tai.kernel @branches() {
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %w = scf.while (%s = %x) : (f32) -> f32 {
      %go = arith.cmpf olt, %s, %one : f32
      scf.condition(%go) %s : f32
    } do {
    ^bb0(%s: f32):
      %t = arith.addf %s, %s : f32
      scf.yield %t : f32
    }
    %c = arith.cmpf ogt, %x, %one : f32
    %r = scf.if %c -> f32 {
      %l = math.log %w : f32
      scf.yield %l : f32
    } else {
      scf.yield %one : f32
    }
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// Sums of tangents are sums, in any order: the loop stays parallel.
// CHECK-LABEL: tai.kernel @sum_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) in @x {
//       CHECK:     tai.atomic sub %[[X:.+]], @a[]
//       CHECK:     tai.atomic sub %{{.+}}, @a_dual[]
tai.kernel @sum() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    tai.atomic sub %x, @a[] : f32
  }
  tai.return
}

// A greatest value has the tangent of the element that it comes from; a tie goes
// to the one that comes later. Where iterations may meet, they run in order.
// CHECK-LABEL: tai.kernel @greatest_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) in @x serialize {
//       CHECK:     %[[X:.+]] = tai.load @x[
//       CHECK:     %[[DX:.+]] = tai.load @x_dual[
//       CHECK:     %[[OLD:.+]] = tai.atomic max %[[X]], @a[]
//       CHECK:     %[[DOLD:.+]] = tai.load @a_dual[]
//       CHECK:     %[[STAYS:.+]] = arith.cmpf ogt, %[[OLD]], %[[X]]
//       CHECK:     %[[NEW:.+]] = arith.select %[[STAYS]], %[[DOLD]], %[[DX]]
//       CHECK:     tai.store %[[NEW]], @a_dual[]
tai.kernel @greatest() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    tai.atomic max %x, @a[] : f32
  }
  tai.return
}

// Each iteration has its own element: it stays parallel, and the value before
// the update has a tangent.
// CHECK-LABEL: tai.kernel @own_product_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) in @x {
//       CHECK:     %[[X:.+]] = tai.load @x[
//       CHECK:     %[[DX:.+]] = tai.load @x_dual[
//       CHECK:     %[[OLD:.+]] = tai.atomic mul %[[X]], @y[
//       CHECK:     %[[DOLD:.+]] = tai.load @y_dual[
//   CHECK-DAG:     %[[KEPT:.+]] = arith.mulf %[[DOLD]], %[[X]]
//   CHECK-DAG:     %[[ADDED:.+]] = arith.mulf %[[OLD]], %[[DX]]
//       CHECK:     %[[NEW:.+]] = arith.addf %[[KEPT]], %[[ADDED]]
//       CHECK:     tai.store %[[NEW]], @y_dual[
//       CHECK:     tai.store %[[OLD]], @x[
//       CHECK:     tai.store %[[DOLD]], @x_dual[
tai.kernel @own_product() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %old = tai.atomic mul %x, @y[%i] : f32
    tai.store %old, @x[%i] : f32
  }
  tai.return
}

// A product with a constant needs no order.
// CHECK-LABEL: tai.kernel @scaled_fwd(
//       CHECK:   tai.parallel_for (%{{.+}}) in @x {
//       CHECK:     tai.atomic mul %[[C:.+]], @a[]
//       CHECK:     tai.atomic mul %[[C]], @a_dual[]
tai.kernel @scaled() {
  tai.parallel_for (%i) in @x {
    %c = tai.load @c[%i] : f32
    tai.atomic mul %c, @a[] : f32
  }
  tai.return
}

// Variables and local arrays get a second one for tangents.
// CHECK-LABEL: tai.kernel @locals_fwd(
//       CHECK:   tai.alloca : !tai.local<f32>
//       CHECK:   tai.alloca : !tai.local<f32>
//       CHECK:   memref.alloc() : memref<4xf32>
//       CHECK:   memref.alloc() : memref<4xf32>
//       CHECK:   memref.dealloc
//       CHECK:   memref.dealloc
tai.kernel @locals() {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %a = tai.alloca : !tai.local<f32>
    %m = memref.alloc() : memref<4xf32>
    %x = tai.load @x[%i] : f32
    tai.local_store %x, %a : f32
    %l = tai.local_load %a : f32
    memref.store %l, %m[%c0] : memref<4xf32>
    %r = memref.load %m[%c0] : memref<4xf32>
    memref.dealloc %m : memref<4xf32>
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// So do the stacks of adjoints that run a kernel forward again.
// CHECK-LABEL: tai.kernel @stacks_fwd(
//       CHECK:   %[[S:.+]] = tai.stack_create : !tai.stack<f32>
//       CHECK:   %[[DS:.+]] = tai.stack_create : !tai.stack<f32>
//       CHECK:   tai.stack_push %{{.+}}, %[[S]]
//       CHECK:   tai.stack_push %{{.+}}, %[[DS]]
//       CHECK:   %[[V:.+]] = tai.stack_pop %[[S]]
//       CHECK:   %[[DV:.+]] = tai.stack_pop %[[DS]]
//       CHECK:   tai.stack_destroy %[[S]]
//       CHECK:   tai.stack_destroy %[[DS]]
//       CHECK:   tai.store %[[V]], @y[
//       CHECK:   tai.store %[[DV]], @y_dual[
tai.kernel @stacks() {
  tai.parallel_for (%i) in @x {
    %s = tai.stack_create : !tai.stack<f32>
    %x = tai.load @x[%i] : f32
    tai.stack_push %x, %s : f32
    %v = tai.stack_pop %s : f32
    tai.stack_destroy %s : !tai.stack<f32>
    tai.store %v, @y[%i] : f32
  }
  tai.return
}

// The tangent of x sqrt(x) at 0 is 0: a zero factor takes nothing of the
// infinity behind it.
// CHECK-LABEL: tai.kernel @root_times_x_fwd(
//   CHECK-DAG:   %[[ZERO:.+]] = arith.constant 0.000000e+00 : f32
//       CHECK:   %[[X:.+]] = tai.load @x[
//       CHECK:   %[[NO_X:.+]] = arith.cmpf oeq, %[[X]], %[[ZERO]]
//       CHECK:   arith.select %[[NO_X]], %[[ZERO]], %{{.+}}
//       CHECK:   tai.store %{{.+}}, @y_dual
tai.kernel @root_times_x() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %s = math.sqrt %x : f32
    %r = arith.mulf %x, %s : f32
    tai.store %r, @y[%i] : f32
  }
  tai.return
}

// One more array for each array of floats; a reduction of tangents beside that
// of values.
// CHECK-LABEL: func.func @arrays_fwd(
//  CHECK-SAME:     %[[X:.+]]: memref<?xf32>, %{{.+}}: memref<?xi32>, %[[DX:[a-z0-9]+]]: memref<?xf32>)
//       CHECK:   scf.parallel {{.*}} init (%{{.+}}, %{{.+}}) -> (f32, f32)
//       CHECK:     memref.load %[[X]]
//       CHECK:     memref.load %[[DX]]
//       CHECK:     scf.reduce(%{{.+}}, %{{.+}} : f32, f32)
//       CHECK:   memref.store %{{.+}}, %[[X]]
//       CHECK:   memref.store %{{.+}}, %[[DX]]
func.func @arrays(%x: memref<?xf32>, %n: memref<?xi32>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  %zero = arith.constant 0.0 : f32
  %r = scf.parallel (%i) = (%c0) to (%c8) step (%c1) init (%zero) -> f32 {
    %v = memref.load %x[%i] : memref<?xf32>
    %w = arith.mulf %v, %v : f32
    scf.reduce(%w : f32) {
    ^bb0(%a: f32, %b: f32):
      %s = arith.addf %a, %b : f32
      scf.reduce.return %s : f32
    }
  }
  memref.store %r, %x[%c0] : memref<?xf32>
  return
}
