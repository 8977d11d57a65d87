// RUN: tai-opt %s --tai-scalarize | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 8], {x: f32, v: vector<2xf32>, m: vector<2x2xf32>}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @v = @t["v"] : vector<2xf32>, rank 1
tai.field @m = @t["m"] : vector<2x2xf32>, rank 1

// Each component is read, computed and written apart.
// CHECK-LABEL: tai.kernel @elementwise(
//  CHECK-SAME:     %[[I:.+]]: index
//   CHECK-DAG:   %[[C0:.+]] = arith.constant 0 : index
//   CHECK-DAG:   %[[C1:.+]] = arith.constant 1 : index
//       CHECK:   %[[A:.+]] = tai.load @v[%[[I]]] component[%[[C0]]] : f32
//       CHECK:   %[[B:.+]] = tai.load @v[%[[I]]] component[%[[C1]]] : f32
//       CHECK:   %[[AA:.+]] = arith.mulf %[[A]], %[[A]] fastmath<reassoc> : f32
//       CHECK:   %[[BB:.+]] = arith.mulf %[[B]], %[[B]] fastmath<reassoc> : f32
//       CHECK:   math.sqrt %[[AA]] : f32
//       CHECK:   math.sqrt %[[BB]] : f32
//       CHECK:   tai.store %{{.+}}, @v[%[[I]]] component[%[[C0]]] : f32
//       CHECK:   tai.store %{{.+}}, @v[%[[I]]] component[%[[C1]]] : f32
//       CHECK:   tai.atomic add %[[AA]], @v[%[[I]]] component[%[[C0]]] exclusive : f32
tai.kernel @elementwise(%i: index) {
  %0 = tai.load @v[%i] : vector<2xf32>
  %1 = arith.mulf %0, %0 fastmath<reassoc> : vector<2xf32>
  %2 = math.sqrt %1 : vector<2xf32>
  tai.store %2, @v[%i] : vector<2xf32>
  %3 = tai.atomic add %1, @v[%i] exclusive : vector<2xf32>
  tai.return
}

// Scalars are left alone.
// CHECK-LABEL: tai.kernel @scalar(
//  CHECK-SAME:     %[[I:.+]]: index
//  CHECK-NEXT:   %[[X:.+]] = tai.load @x[%[[I]]] : f32
//  CHECK-NEXT:   tai.store %[[X]], @x[%[[I]]] : f32
tai.kernel @scalar(%i: index) {
  %0 = tai.load @x[%i] : f32
  tai.store %0, @x[%i] : f32
  tai.return
}

// Loops and branches carry components.
// CHECK-LABEL: tai.kernel @structure(
//       CHECK:   %[[R:.+]]:2 = scf.for {{.+}} iter_args(%[[P:.+]] = %{{.+}}, %[[Q:.+]] = %{{.+}}) -> (f32, f32)
//       CHECK:     %[[S:.+]]:2 = scf.if %{{.+}} -> (f32, f32) {
//       CHECK:       scf.yield %{{.+}}, %{{.+}} : f32, f32
//       CHECK:     scf.yield %[[S]]#0, %[[S]]#1 : f32, f32
//       CHECK:   scf.while (%{{.+}} = %[[R]]#0, %{{.+}} = %[[R]]#1)
//       CHECK:     scf.condition(%{{.+}}) %{{.+}}, %{{.+}} : f32, f32
//       CHECK:   ^bb0(%{{.+}}: f32, %{{.+}}: f32):
tai.kernel @structure(%i: index, %c: i1) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %0 = tai.load @v[%i] : vector<2xf32>
  %1 = scf.for %k = %c0 to %i step %c1 iter_args(%s = %0) -> (vector<2xf32>) {
    %2 = scf.if %c -> (vector<2xf32>) {
      %3 = arith.addf %s, %0 : vector<2xf32>
      scf.yield %3 : vector<2xf32>
    } else {
      scf.yield %s : vector<2xf32>
    }
    scf.yield %2 : vector<2xf32>
  }
  %4 = scf.while (%s = %1) : (vector<2xf32>) -> vector<2xf32> {
    scf.condition(%c) %s : vector<2xf32>
  } do {
  ^bb0(%s: vector<2xf32>):
    scf.yield %s : vector<2xf32>
  }
  tai.store %4, @v[%i] : vector<2xf32>
  tai.return
}

// The caller's types stay.
// CHECK-LABEL: tai.kernel @boundary(
//  CHECK-SAME:     %[[V:.+]]: vector<2xf32>) -> vector<2xf32>
//       CHECK:   %[[P:.+]]:2 = vector.to_elements %[[V]] : vector<2xf32>
//       CHECK:   %[[N0:.+]] = arith.negf %[[P]]#0 : f32
//       CHECK:   %[[N1:.+]] = arith.negf %[[P]]#1 : f32
//       CHECK:   %[[R:.+]] = vector.from_elements %[[N0]], %[[N1]]
//       CHECK:   tai.return %[[R]] : vector<2xf32>
tai.kernel @boundary(%v: vector<2xf32>) -> vector<2xf32> {
  %0 = arith.negf %v : vector<2xf32>
  tai.return %0 : vector<2xf32>
}

// Launches too.
// CHECK-LABEL: func.func @host()
//       CHECK:   %[[ARG:.+]] = vector.from_elements
//       CHECK:   %[[RES:.+]] = tai.launch @boundary(%[[ARG]])
//       CHECK:   vector.to_elements %[[RES]]
func.func @host() -> f32 {
  %0 = arith.constant dense<[1.0, 2.0]> : vector<2xf32>
  %1 = tai.launch @boundary(%0) : (vector<2xf32>) -> vector<2xf32>
  %2 = vector.extract %1[1] : f32 from vector<2xf32>
  return %2 : f32
}

// A position that is not constant is a select.
// CHECK-LABEL: tai.kernel @dynamic(
//  CHECK-SAME:     %[[X:[^:]+]]: f32, %[[Y:[^:]+]]: f32, %[[K:[^:]+]]: index,
//       CHECK:   arith.cmpi eq, %[[K]], %{{.+}} : index
//       CHECK:   %[[IS1:.+]] = arith.cmpi eq, %[[K]], %{{.+}} : index
//       CHECK:   arith.select %[[IS1]], %[[Y]], %[[X]] : f32
//       CHECK:   %[[AT0:.+]] = arith.cmpi eq, %[[K]], %{{.+}} : index
//       CHECK:   arith.select %[[AT0]], %{{.+}}, %[[X]] : f32
tai.kernel @dynamic(%x: f32, %y: f32, %k: index, %i: index) {
  %v = vector.from_elements %x, %y : vector<2xf32>
  %0 = vector.extract %v[%k] : f32 from vector<2xf32>
  %1 = vector.insert %0, %v[%k] : f32 into vector<2xf32>
  tai.store %1, @v[%i] : vector<2xf32>
  tai.return
}

// A position beyond the vector, or at -1, is poison: any component will do, and
// an insertion there is dropped.
// CHECK-LABEL: tai.kernel @beyond(
//  CHECK-SAME:     %[[X:[^:]+]]: f32, %[[Y:[^:]+]]: f32, %[[I:[^:]+]]: index)
//   CHECK-NOT:   vector.
//       CHECK:   tai.store %[[X]], @x[%[[I]]]
//       CHECK:   tai.store %[[X]], @v[%[[I]]] component[%c0] : f32
//       CHECK:   tai.store %[[Y]], @v[%[[I]]] component[%c1] : f32
tai.kernel @beyond(%x: f32, %y: f32, %i: index) {
  %c7 = arith.constant 7 : index
  %v = vector.from_elements %x, %y : vector<2xf32>
  %0 = vector.extract %v[%c7] : f32 from vector<2xf32>
  %1 = vector.extract %v[-1] : f32 from vector<2xf32>
  tai.store %0, @x[%i] : f32
  tai.store %1, @x[%i] : f32
  %3 = vector.insert %x, %v[-1] : f32 into vector<2xf32>
  %4 = vector.insert %x, %3[%c7] : f32 into vector<2xf32>
  tai.store %4, @v[%i] : vector<2xf32>
  tai.return
}

// The ops that rearrange vectors leave nothing behind.
// CHECK-LABEL: tai.kernel @rearrange(
//  CHECK-SAME:     %[[A:.+]]: f32, %[[B:.+]]: f32, %[[I:.+]]: index
//   CHECK-NOT:   vector.
//       CHECK:   tai.store %[[A]], @m[%[[I]]] component[%c0, %c0] : f32
//       CHECK:   tai.store %[[B]], @m[%[[I]]] component[%c0, %c1] : f32
//       CHECK:   tai.store %[[A]], @m[%[[I]]] component[%c1, %c0] : f32
//       CHECK:   tai.store %[[B]], @m[%[[I]]] component[%c1, %c1] : f32
tai.kernel @rearrange(%a: f32, %b: f32, %i: index) {
  %0 = vector.from_elements %b, %a : vector<2xf32>
  %1 = vector.shuffle %0, %0 [1, 0] : vector<2xf32>, vector<2xf32>
  %2 = vector.broadcast %1 : vector<2xf32> to vector<2x2xf32>
  %3 = vector.transpose %2, [1, 0] : vector<2x2xf32> to vector<2x2xf32>
  %4 = vector.shape_cast %3 : vector<2x2xf32> to vector<4xf32>
  %5 = vector.extract_strided_slice %4 {offsets = [0], sizes = [2], strides = [1]} : vector<4xf32> to vector<2xf32>
  %6 = vector.insert_strided_slice %5, %4 {offsets = [0], strides = [1]} : vector<2xf32> into vector<4xf32>
  %7 = vector.shape_cast %6 : vector<4xf32> to vector<2x2xf32>
  %8 = vector.transpose %7, [1, 0] : vector<2x2xf32> to vector<2x2xf32>
  tai.store %8, @m[%i] : vector<2x2xf32>
  tai.return
}

// Sums of components.
// CHECK-LABEL: tai.kernel @reduce(
//  CHECK-SAME:     %[[A:.+]]: f32, %[[B:.+]]: f32
//       CHECK:   %[[S:.+]] = arith.addf %[[A]], %[[B]] : f32
//       CHECK:   %[[M:.+]] = arith.mulf %[[A]], %[[B]] : f32
//       CHECK:   tai.return
tai.kernel @reduce(%a: f32, %b: f32) -> f32 {
  %0 = vector.from_elements %a, %b : vector<2xf32>
  %1 = vector.reduction <add>, %0 : vector<2xf32> into f32
  %2 = vector.reduction <mul>, %0 : vector<2xf32> into f32
  %3 = arith.addf %1, %2 : f32
  tai.return %3 : f32
}

// A local of vector type is one local for each component.
// CHECK-LABEL: tai.kernel @local(
//       CHECK:   %[[L0:.+]] = tai.alloca : !tai.local<f32>
//       CHECK:   %[[L1:.+]] = tai.alloca : !tai.local<f32>
//       CHECK:   tai.local_store %{{.+}}, %[[L0]] : f32
//       CHECK:   tai.local_store %{{.+}}, %[[L1]] : f32
//       CHECK:   tai.local_load %[[L0]] : f32
tai.kernel @local(%i: index) {
  %l = tai.alloca : !tai.local<vector<2xf32>>
  %0 = tai.load @v[%i] : vector<2xf32>
  tai.local_store %0, %l : vector<2xf32>
  %1 = tai.local_load %l : vector<2xf32>
  tai.store %1, @v[%i] : vector<2xf32>
  tai.return
}

// A message keeps the numbers of components.
// CHECK-LABEL: tai.kernel @message(
//       CHECK:   tai.print "{} {}"(%{{.+}}, %{{.+}}, %{{.+}}) : f32, f32, index {shapes = array<i32: 2, 1>}
tai.kernel @message(%i: index) {
  %0 = tai.load @v[%i] : vector<2xf32>
  tai.print "{} {}"(%0, %i) : vector<2xf32>, index
  tai.return
}

// An array of vectors is an array of scalars with one more dimension, of which
// the caller does not know.
// CHECK-LABEL: tai.kernel @array(
//  CHECK-SAME:     %[[M:.+]]: memref<?x2xf32> {tai.element_rank = 1 : i64}, %[[I:.+]]: index
//       CHECK:   memref.load %[[M]][%[[I]], %c0]
//       CHECK:   memref.load %[[M]][%[[I]], %c1]
//       CHECK:   memref.store %{{.+}}, %[[M]][%[[I]], %c0]
tai.kernel @array(%m: memref<?xvector<2xf32>>, %i: index) {
  %0 = memref.load %m[%i] : memref<?xvector<2xf32>>
  memref.store %0, %m[%i] : memref<?xvector<2xf32>>
  tai.return
}

// The condition of a select is one for all components, or one for each.
// CHECK-LABEL: tai.kernel @select(
//  CHECK-SAME:     %[[C:[^:]+]]: i1
//       CHECK:   arith.cmpf olt
//       CHECK:   %[[D:.+]] = arith.cmpf olt
//       CHECK:   arith.select %[[C]], {{.+}} : f32
//       CHECK:   arith.select %[[C]], {{.+}} : f32
//       CHECK:   arith.select %[[D]], {{.+}} : f32
tai.kernel @select(%c: i1, %i: index, %a: vector<2xf32>, %b: vector<2xf32>) {
  %0 = arith.cmpf olt, %a, %b : vector<2xf32>
  %1 = arith.select %c, %a, %b : vector<2xf32>
  %2 = arith.select %0, %1, %b : vector<2xi1>, vector<2xf32>
  tai.store %2, @v[%i] : vector<2xf32>
  tai.return
}
