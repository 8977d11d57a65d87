// RUN: tai-opt %s --split-input-file --tai-vectorize-blocks=max-ops=64 --cse | FileCheck %s
// RUN: tai-opt %s --split-input-file --tai-vectorize-blocks=max-ops=4 --cse | FileCheck %s --check-prefix=FEW

// A loop over elements becomes one over blocks. Where a block and its neighbours
// are inside, its rows are vectors: across a border, a shuffle of two.
tai.tree @t : !tai.root<pointer<[i: 4, j: 4], dense<[i: 2, j: 8], {x: f32}>>, pointer<[i: 4, j: 4], dense<[i: 2, j: 8], {y: f32}>>>
tai.field @x = @t["x"] : f32, rank 2
tai.field @y = @t["y"] : f32, rank 2

// CHECK-LABEL: tai.kernel @stencil
//       CHECK:   tai.parallel_for (%[[I:.+]], %[[J:.+]]) in @x level 2 {
//   CHECK-DAG:     %[[ENOUGH_I:.+]] = arith.cmpi ule, %{{.+}}, %{{.+}}
//   CHECK-DAG:     %[[ENOUGH_J:.+]] = arith.cmpi ule, %{{.+}}, %{{.+}}
//       CHECK:     tai.is_active @y[%[[I]], %[[J]]] level 2
//       CHECK:     tai.activate @y[%[[I]], %[[J]]] level 2
//       CHECK:     scf.if %{{.+}} {
//   CHECK-NOT:       scf.for
//       CHECK:       llvm.load {{.*}} -> vector<8xf32>
//       CHECK:       llvm.shufflevector %{{.+}} [1, 2, 3, 4, 5, 6, 7, 8] : vector<8xf32>
//       CHECK:       arith.addf {{.*}} : vector<8xf32>
//       CHECK:       llvm.store {{.*}} : vector<8xf32>
//       CHECK:       llvm.store {{.*}} : vector<8xf32>
//   CHECK-NOT:       llvm.store
//       CHECK:     } else {
//       CHECK:       scf.for
//       CHECK:         scf.for
//       CHECK:           tai.store

// Too much to write out for each row: a loop over rows.
//   FEW-LABEL: tai.kernel @stencil
//         FEW:   scf.for
//         FEW:     llvm.store {{.*}} : vector<8xf32>
//     FEW-NOT:     llvm.store
//         FEW:   } else {
tai.kernel @stencil() {
  %one = arith.constant 1 : index
  tai.parallel_for (%i, %j) in @x {
    %up = arith.subi %i, %one : index
    %right = arith.addi %j, %one : index
    %a = tai.load @x[%up, %j] : f32
    %b = tai.load @x[%i, %right] : f32
    %c = arith.addf %a, %b : f32
    tai.store %c, @y[%i, %j] : f32
  }
  tai.return
}

// All blocks are inside, and all cells known to be active: one path.
// CHECK-LABEL: tai.kernel @scale
//   CHECK-NOT:   scf.if
//       CHECK:   llvm.store {{.*}} : vector<8xf32>
//   CHECK-NOT:   tai.store
//       CHECK:   tai.return
tai.kernel @scale(%s: f32) {
  tai.parallel_for (%i, %j) in @x {
    %a = tai.load @x[%i, %j] : f32
    %b = arith.mulf %a, %s : f32
    tai.store %b, @x[%i, %j] : f32
  }
  tai.return
}

// An adjoint makes nothing active.
// CHECK-LABEL: tai.kernel @keeps
//   CHECK-NOT:   tai.activate
//       CHECK:   tai.is_active @y
//   CHECK-NOT:   tai.activate
//       CHECK:   vector<8xf32>
//       CHECK:   tai.return
tai.kernel @keeps() attributes {keeps_activity} {
  tai.parallel_for (%i, %j) in @x {
    %a = tai.load @x[%i, %j] : f32
    tai.atomic add %a, @y[%i, %j] exclusive : f32
  }
  tai.return
}

// Accesses that depend on data, on two indices at once, or on the order of
// iterations are made element by element.
// CHECK-LABEL: tai.kernel @data
//   CHECK-NOT:   level 2
//       CHECK:   tai.return
tai.kernel @data() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i, %j) in @x {
    %a = tai.load @x[%i, %j] : f32
    %positive = arith.cmpf ogt, %a, %zero : f32
    scf.if %positive {
      tai.store %a, @y[%i, %j] : f32
    }
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @diagonal
//   CHECK-NOT:   level 2
//       CHECK:   tai.return
tai.kernel @diagonal() {
  tai.parallel_for (%i, %j) in @x {
    %k = arith.addi %i, %j : index
    %a = tai.load @x[%i, %k] : f32
    tai.store %a, @y[%i, %j] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @in_place
//   CHECK-NOT:   level 2
//       CHECK:   tai.return
tai.kernel @in_place() {
  %one = arith.constant 1 : index
  tai.parallel_for (%i, %j) in @x {
    %left = arith.subi %j, %one : index
    %a = tai.load @x[%i, %left] : f32
    tai.store %a, @x[%i, %j] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @contended
//   CHECK-NOT:   level 2
//       CHECK:   tai.return
tai.kernel @contended() {
  %one = arith.constant 1 : index
  tai.parallel_for (%i, %j) in @x {
    %left = arith.subi %j, %one : index
    %a = tai.load @x[%i, %j] : f32
    %old = tai.atomic add %a, @y[%i, %left] : f32
  }
  tai.return
}

// -----

// Places side by side in a cell: the bytes between are not touched.
tai.tree @t : !tai.root<dense<[i: 4], dense<[i: 4], {a: f64, x: vector<2xf64>}>>>
tai.field @a = @t["a"] : f64, rank 1
tai.field @x = @t["x"] : vector<2xf64>, rank 1

// CHECK-LABEL: tai.kernel @beside
//       CHECK:   llvm.load {{.*}} -> vector<12xf64>
//       CHECK:   llvm.shufflevector {{.*}} [2, 5, 8, 11] : vector<12xf64>
//       CHECK:   llvm.intr.masked.store {{.*}} : vector<12xf64>, vector<12xi1>
tai.kernel @beside() {
  %one = arith.constant 1 : index
  tai.parallel_for (%i) in @a {
    %v = tai.load @x[%i] component [%one] : f64
    tai.store %v, @a[%i] : f64
  }
  tai.return
}

// -----

// Rows of no power of two.
tai.tree @t : !tai.root<bitmasked<[i: 4], dense<[i: 6], {x: f32}>>>
tai.field @x = @t["x"] : f32, rank 1

// CHECK-LABEL: tai.kernel @odd
//   CHECK-NOT:   level 2
//       CHECK:   tai.return
tai.kernel @odd() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f32
    tai.store %v, @x[%i] : f32
  }
  tai.return
}

// -----

// The interior of a loop that asks for neighbours is where they are active.
tai.tree @t : !tai.root<bitmasked<[i: 8], dense<[i: 8], {x: f32, g: f32}>>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @g = @t["g"] : f32, rank 1

// CHECK-LABEL: tai.kernel @neighbours
//       CHECK:   tai.parallel_for (%[[I:.+]]) in @x level 2 {
//       CHECK:     tai.is_active @x[%[[I]]] level 2
//       CHECK:     %[[RIGHT:.+]] = arith.addi %[[I]], %{{.+}} overflow<nsw> : index
//       CHECK:     tai.is_active @x[%[[RIGHT]]] level 2
//       CHECK:     llvm.shufflevector {{.*}} [1, 2, 3, 4, 5, 6, 7, 8]
//   CHECK-NOT:     tai.is_active
//       CHECK:     llvm.intr.masked.store
//       CHECK:   } else {
//       CHECK:     tai.is_active
tai.kernel @neighbours() attributes {keeps_activity} {
  %one = arith.constant 1 : index
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %right = arith.addi %i, %one : index
    %there = tai.is_active @x[%right] level 2
    %v = scf.if %there -> f32 {
      %0 = tai.load @g[%right] : f32
      scf.yield %0 : f32
    } else {
      scf.yield %zero : f32
    }
    tai.atomic add %v, @x[%i] exclusive : f32
  }
  tai.return
}
