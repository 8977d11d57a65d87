// RUN: tai-opt %s --tai-vectors-to-memory --canonicalize --split-input-file | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 8], {x: f32, v: vector<8xf32>}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @v = @t["v"] : vector<8xf32>, rank 1

// A loop-carried vector is written in place, also in a branch.
// CHECK-LABEL: tai.kernel @in_place(
//       CHECK:   tai.parallel_for
//       CHECK:     %[[A:.+]] = memref.alloca() : memref<8xf32>
// CHECK-COUNT-8:   memref.store %{{.+}}, %[[A]]
//       CHECK:     scf.while : () -> ()
//       CHECK:       memref.load %[[A]]
//       CHECK:       scf.condition(%{{.+}})
//       CHECK:       scf.if
//  CHECK-NEXT:         memref.store %{{.+}}, %[[A]]
//  CHECK-NEXT:       }
//   CHECK-NOT:   memref.alloca
//   CHECK-NOT:   vector
//       CHECK:   tai.return
tai.kernel @in_place(%n: index, %c: i1, %y: f32) {
  %zero = arith.constant dense<0.0> : vector<8xf32>
  %c8 = arith.constant 8 : index
  %c7 = arith.constant 7 : index
  %below = arith.cmpi ult, %n, %c8 : index
  %at = arith.select %below, %n, %c7 : index
  tai.parallel_for (%i) in @x {
    %r = scf.while (%w = %zero) : (vector<8xf32>) -> vector<8xf32> {
      %x = vector.extract %w[%at] : f32 from vector<8xf32>
      %d = arith.cmpf olt, %x, %y : f32
      scf.condition(%d) %w : vector<8xf32>
    } do {
    ^bb0(%w: vector<8xf32>):
      %z = scf.if %c -> vector<8xf32> {
        %u = vector.insert %y, %w[%at] : f32 into vector<8xf32>
        scf.yield %u : vector<8xf32>
      } else {
        scf.yield %w : vector<8xf32>
      }
      scf.yield %z : vector<8xf32>
    }
    %s = vector.extract %r[3] : f32 from vector<8xf32>
    tai.store %s, @x[%i] : f32
  }
  tai.return
}

// The old vector is still needed: it is copied before.
// CHECK-LABEL: tai.kernel @copied(
//   CHECK-DAG:   %[[A:.+]] = memref.alloca() : memref<8xf32>
//   CHECK-DAG:   %[[B:.+]] = memref.alloca() : memref<8xf32>
//       CHECK:   scf.for
//       CHECK:     scf.for
//       CHECK:       %[[E:.+]] = memref.load
//       CHECK:       memref.store %[[E]]
//       CHECK:     memref.store
//       CHECK:   tai.return
tai.kernel @copied(%n: index, %y: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %v = tai.load @v[%c0] : vector<8xf32>
  %r = scf.for %k = %c0 to %n step %c1 iter_args(%s = %y) -> f32 {
    %u = vector.insert %s, %v[%k] : f32 into vector<8xf32>
    %a = vector.extract %u[%n] : f32 from vector<8xf32>
    %b = vector.extract %v[%n] : f32 from vector<8xf32>
    %d = arith.subf %a, %b : f32
    scf.yield %d : f32
  }
  tai.store %r, @x[%c0] : f32
  tai.return
}

// A position that may not be there reads the first component and writes none,
// as scalars do.
// CHECK-LABEL: tai.kernel @positions(
//  CHECK-SAME:     %[[N:.+]]: index, %[[M:[^:]+]]: index
//       CHECK:   scf.for
//       CHECK:     %[[ROW:.+]] = arith.cmpi ult, %[[N]], %{{.+}} : index
//       CHECK:     arith.select %[[ROW]], %[[N]], %{{.+}} : index
//       CHECK:     %[[COLUMN:.+]] = arith.cmpi ult, %[[M]], %{{.+}} : index
//       CHECK:     %[[BOTH:.+]] = arith.andi %[[ROW]], %[[COLUMN]]
//       CHECK:     %[[OLD:.+]] = memref.load
//       CHECK:     %[[NEW:.+]] = arith.select %[[BOTH]], %{{.+}}, %[[OLD]]
//       CHECK:     memref.store %[[NEW]]
//       CHECK:   tai.return
tai.kernel @positions(%n: index, %m: index, %y: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant dense<0.0> : vector<3x4xf32>
  %r = scf.for %k = %c0 to %n step %c1 iter_args(%w = %zero) -> vector<3x4xf32> {
    %u = vector.insert %y, %w[%n, %m] : f32 into vector<3x4xf32>
    scf.yield %u : vector<3x4xf32>
  }
  %s = vector.extract %r[2, 1] : f32 from vector<3x4xf32>
  tai.store %s, @x[%c0] : f32
  tai.return
}

// Ops on whole vectors read and make them.
// CHECK-LABEL: tai.kernel @whole(
//       CHECK:   %[[A:.+]] = memref.alloca() : memref<8xf32>
//       CHECK:   tai.load @v
//       CHECK:   scf.for
//       CHECK:     memref.store
// CHECK-COUNT-8: memref.load %[[A]]
//       CHECK:   %[[W:.+]] = vector.from_elements
//       CHECK:   tai.store %[[W]], @v
tai.kernel @whole(%n: index, %y: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %v = tai.load @v[%c0] : vector<8xf32>
  %r = scf.for %k = %c0 to %n step %c1 iter_args(%w = %v) -> vector<8xf32> {
    %u = vector.insert %y, %w[%k] : f32 into vector<8xf32>
    scf.yield %u : vector<8xf32>
  }
  tai.store %r, @v[%c0] : vector<8xf32>
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {x: f32, v: vector<8xf32>, s: vector<6xf32>}>>
tai.field @x = @t["x"] : f32, rank 1
tai.field @v = @t["v"] : vector<8xf32>, rank 1
tai.field @s = @t["s"] : vector<6xf32>, rank 1

// Few components, in a loop and elsewhere, are better off as scalars.
// CHECK-LABEL: tai.kernel @few(
//   CHECK-NOT:   memref
//       CHECK:   tai.return
tai.kernel @few(%n: index, %y: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %s = tai.load @s[%c0] : vector<6xf32>
  %r = scf.for %k = %c0 to %n step %c1 iter_args(%w = %s) -> vector<6xf32> {
    %u = vector.insert %y, %w[%k] : f32 into vector<6xf32>
    scf.yield %u : vector<6xf32>
  }
  tai.store %r, @s[%c0] : vector<6xf32>
  %v = tai.load @v[%c0] : vector<8xf32>
  %u = vector.insert %y, %v[%n] : f32 into vector<8xf32>
  tai.store %u, @v[%c0] : vector<8xf32>
  tai.return
}

// So are those that no index at run time names.
// CHECK-LABEL: tai.kernel @static(
//   CHECK-NOT:   memref
//       CHECK:   tai.return
tai.kernel @static(%n: index, %y: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %v = tai.load @v[%c0] : vector<8xf32>
  %r = scf.for %k = %c0 to %n step %c1 iter_args(%w = %v) -> vector<8xf32> {
    %u = vector.insert %y, %w[5] : f32 into vector<8xf32>
    scf.yield %u : vector<8xf32>
  }
  tai.store %r, @v[%c0] : vector<8xf32>
  tai.return
}

// The stack has no room for these.
// CHECK-LABEL: tai.kernel @large(
//   CHECK-NOT:   memref
//       CHECK:   tai.return
tai.kernel @large(%n: index, %y: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %zero = arith.constant dense<0.0> : vector<8193xf32>
  %r = scf.for %k = %c0 to %n step %c1 iter_args(%w = %zero) -> vector<8193xf32> {
    %u = vector.insert %y, %w[%k] : f32 into vector<8193xf32>
    scf.yield %u : vector<8193xf32>
  }
  %e = vector.extract %r[7] : f32 from vector<8193xf32>
  tai.store %e, @x[%c0] : f32
  tai.return
}

// Iterations that run at the same time each have their own.
// CHECK-LABEL: tai.kernel @from_outside(
//       CHECK:   tai.load @v
//   CHECK-NOT:   memref.alloca
//       CHECK:   tai.parallel_for
//       CHECK:     %[[A:.+]] = memref.alloca() : memref<8xf32>
// CHECK-COUNT-8:   memref.store %{{.+}}, %[[A]]
//       CHECK:     scf.for
//       CHECK:       memref.store %{{.+}}, %[[A]]
//       CHECK:   tai.return
tai.kernel @from_outside(%n: index, %y: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %v = tai.load @v[%c0] : vector<8xf32>
  tai.parallel_for (%i) in @x {
    %r = scf.for %k = %c0 to %n step %c1 iter_args(%w = %v) -> vector<8xf32> {
      %u = vector.insert %y, %w[%k] : f32 into vector<8xf32>
      scf.yield %u : vector<8xf32>
    }
    %e = vector.extract %r[7] : f32 from vector<8xf32>
    tai.store %e, @x[%i] : f32
  }
  tai.return
}

// Buffers that take each other's place would be pointers: scalars remain.
// CHECK-LABEL: tai.kernel @swapped(
//   CHECK-NOT:   memref
//       CHECK:   scf.for {{.+}} -> (vector<8xf32>, vector<8xf32>)
//       CHECK:   tai.return
tai.kernel @swapped(%n: index, %y: f32) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %v = tai.load @v[%c0] : vector<8xf32>
  %w = tai.load @v[%c1] : vector<8xf32>
  %r:2 = scf.for %k = %c0 to %n step %c1 iter_args(%a = %v, %b = %w) -> (vector<8xf32>, vector<8xf32>) {
    %u = vector.insert %y, %a[%k] : f32 into vector<8xf32>
    scf.yield %b, %u : vector<8xf32>, vector<8xf32>
  }
  tai.store %r#0, @v[%c0] : vector<8xf32>
  tai.store %r#1, @v[%c1] : vector<8xf32>
  tai.return
}

// Loops that are made of blocks are left alone.
// CHECK-LABEL: func.func @blocks(
//   CHECK-NOT:   memref
//       CHECK:   return
func.func @blocks(%v: vector<8xf32>, %n: index, %y: f32, %c: i1) -> f32 {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  cf.br ^loop
^loop:
  %e = vector.extract %v[%n] : f32 from vector<8xf32>
  %r = scf.for %k = %c0 to %n step %c1 iter_args(%w = %v) -> vector<8xf32> {
    %u = vector.insert %y, %w[%k] : f32 into vector<8xf32>
    scf.yield %u : vector<8xf32>
  }
  %f = vector.extract %r[%n] : f32 from vector<8xf32>
  cf.cond_br %c, ^loop, ^end
^end:
  %s = arith.addf %e, %f : f32
  return %s : f32
}
