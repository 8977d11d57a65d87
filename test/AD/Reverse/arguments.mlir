// RUN: tai-opt %s --tai-make-adjoint --canonicalize --cse | FileCheck %s
// RUN: tai-opt %s --tai-autodiff --tai-to-llvm | FileCheck %s --check-prefix=LLVM

// Variables of a derivative besides fields: arguments, arrays and results that
// `tai.gradients` names.

tai.tree @t : !tai.root<dense<[i: 1024], {x: f32, x_grad: f32, y: f32, y_grad: f32}>>
tai.field @x_grad = @t["x_grad"] : f32, rank 1
tai.field @y_grad = @t["y_grad"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @x_grad
tai.field @y = @t["y"] : f32, rank 1, adjoint @y_grad

// The sweep begins with the adjoint of the result and ends with those of the
// arguments. The contributions of the iterations are summed up before.
// CHECK-LABEL: tai.kernel @scale_grad(
//  CHECK-SAME:     %[[A:.+]]: f32, %[[V:.+]]: vector<2xf32>, %[[N:.+]]: i32, %[[GA:.+]]: memref<f32>, %[[GV:.+]]: memref<2xf32>, %[[GR:.+]]: memref<f32>) {
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//       CHECK:   %[[SEED:.+]] = memref.load %[[GR]][]
//       CHECK:   tai.parallel_for
//       CHECK:     tai.atomic add %{{.+}}, @x_grad[%{{.+}}] exclusive
//   CHECK-NOT:     memref.atomic_rmw {{.+}}[%[[C0]]] : (f32, memref<2xf32>)
//   CHECK-DAG:     memref.atomic_rmw addf %{{.+}}, %[[SUMV:.+]][%[[C1]]] : (f32, memref<2xf32>)
//   CHECK-DAG:     memref.atomic_rmw addf %{{.+}}, %[[SUMS:.+]][%[[C0]]] : (f32, memref<1xf32>)
//       CHECK:   %[[S:.+]] = memref.load %[[SUMS]][%[[C0]]]
//       CHECK:   %[[GS:.+]] = arith.addf %[[SEED]], %[[S]]
//       CHECK:   %[[COS:.+]] = math.cos %[[A]]
//       CHECK:   %[[D:.+]] = arith.mulf %[[GS]], %[[COS]]
//       CHECK:   %[[OLD:.+]] = memref.load %[[GA]][]
//       CHECK:   %[[NEW:.+]] = arith.addf %[[OLD]], %[[D]]
//       CHECK:   memref.store %[[NEW]], %[[GA]][]
//       CHECK:   memref.store %{{.+}}, %[[GV]][%[[C0]]]
//       CHECK:   memref.store %{{.+}}, %[[GV]][%[[C1]]]
//       CHECK:   tai.return
tai.kernel @scale(%a: f32, %v: vector<2xf32>, %n: i32) -> f32
    attributes {tai.gradients = array<i64: 0, 1, 3>} {
  %s = math.sin %a : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %s : f32
    %w = vector.extract %v[1] : f32 from vector<2xf32>
    %2 = arith.mulf %w, %1 : f32
    tai.store %2, @y[%i] : f32
  }
  tai.return %s : f32
}

// Elements that several iterations may reach get atomic additions, those of
// vectors one for each component; the others get plain ones.
// CHECK-LABEL: tai.kernel @gather_grad(
//  CHECK-SAME:     %[[G:[^:]+]]: memref<?x2xf32>, %[[GY:[^:]+]]: memref<?x2xf32>) {
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//       CHECK:   tai.parallel_for (%[[I:.+]]) =
//       CHECK:     %[[J:.+]] = arith.index_cast
//       CHECK:     %[[U:.+]] = memref.load %[[GY]][%[[I]], %[[C0]]]
//       CHECK:     %[[V:.+]] = memref.load %[[GY]][%[[I]], %[[C1]]]
//       CHECK:     memref.atomic_rmw addf %[[U]], %[[G]][%[[J]], %[[C0]]]
//       CHECK:     memref.atomic_rmw addf %[[V]], %[[G]][%[[J]], %[[C1]]]
tai.kernel @gather(%x: memref<?xvector<2xf32>>, %at: memref<?xi32>, %y: memref<?xvector<2xf32>>, %n: index)
    attributes {tai.gradients = array<i64: 0, 2>} {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    %k = memref.load %at[%i] : memref<?xi32>
    %j = arith.index_cast %k : i32 to index
    %v = memref.load %x[%j] : memref<?xvector<2xf32>>
    memref.store %v, %y[%i] : memref<?xvector<2xf32>>
  }
  tai.return
}

// Other arguments are constant, whatever their type.
// CHECK-LABEL: tai.kernel @constant_grad(
//  CHECK-SAME:     %{{[^:]+}}: memref<?xf64>, %{{[^:]+}}: f64, %[[GB:[^:]+]]: memref<f64>, %[[GR:[^:]+]]: memref<f64>) {
//  CHECK-NEXT:   %[[C0:.+]] = arith.constant 0 : index
//  CHECK-NEXT:   %[[SEED:.+]] = memref.load %[[GR]][]
//       CHECK:   %[[X:.+]] = memref.load %{{.+}}[%[[C0]]]
//       CHECK:   %[[D:.+]] = arith.mulf %[[SEED]], %[[X]]
//   CHECK-NOT:   arith.mulf
//       CHECK:   memref.store %{{.+}}, %[[GB]][]
//  CHECK-NEXT:   tai.return
tai.kernel @constant(%x: memref<?xf64>, %b: f64) -> f64 attributes {tai.gradients = array<i64: 1, 2>} {
  %c0 = arith.constant 0 : index
  %0 = memref.load %x[%c0] : memref<?xf64>
  %1 = arith.mulf %0, %b : f64
  tai.return %1 : f64
}

// A function works alike.
// CHECK-LABEL: func.func @inner_grad(
//  CHECK-SAME:     %[[A:[^:]+]]: f64, %[[B:[^:]+]]: f64, %[[GA:[^:]+]]: memref<f64>, %[[GR:[^:]+]]: memref<f64>) {
//       CHECK:   %[[SEED:.+]] = memref.load %[[GR]][]
//       CHECK:   arith.mulf %[[SEED]], %[[B]]
//       CHECK:   memref.store %{{.+}}, %[[GA]][]
func.func @inner(%a: f64, %b: f64) -> f64 attributes {tai.differentiate, tai.gradients = array<i64: 0, 2>} {
  %0 = arith.mulf %a, %b : f64
  return %0 : f64
}

// No iteration of the loop waits for another: the sums are in registers. Only
// the array of @gather is added to in memory.
// LLVM: llvm.func internal @{{.*}}gather{{.*}} {
// LLVM-COUNT-2: llvm.atomicrmw
// LLVM-NOT: llvm.atomicrmw
