// RUN: tai-opt %s --tai-recognize-reductions --canonicalize | FileCheck %s

// A vector is loaded, changed in some components and stored.

!t = !tai.root<dense<[i: 64], {x: f32, b: i32}>, dense<[i: 8], {v: vector<3xf32>}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @b = @t["b"] : i32, rank 1
tai.field @v = @t["v"] : vector<3xf32>, rank 1

// One component is inserted: the others keep their values.
// CHECK-LABEL: tai.kernel @insert
//   CHECK-NOT: tai.load @v
//       CHECK: tai.atomic add %{{.*}}, @v[%{{.*}}] component[%c1] : f32
//   CHECK-NOT: tai.atomic
//   CHECK-NOT: tai.store
//       CHECK: tai.return
tai.kernel @insert() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @v[%1] : vector<3xf32>
    %3 = tai.load @x[%i] : f32
    %4 = vector.extract %2[1] : f32 from vector<3xf32>
    %5 = arith.addf %4, %3 : f32
    %6 = vector.insert %5, %2[1] : f32 into vector<3xf32>
    tai.store %6, @v[%1] : vector<3xf32>
  }
  tai.return
}

// Two of three elements of a list change, by two operations.
// CHECK-LABEL: tai.kernel @elements
//   CHECK-NOT: tai.load @v
//   CHECK-DAG: tai.atomic add %{{.*}}, @v[%{{.*}}] component[%c0] : f32
//   CHECK-DAG: tai.atomic {{(min|max|minimumf|maximumf).*}}, @v[%{{.*}}] component[%c2] : f32
//   CHECK-NOT: tai.store
//       CHECK: tai.return
tai.kernel @elements() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @v[%1] : vector<3xf32>
    %3 = tai.load @x[%i] : f32
    %5 = vector.extract %2[0] : f32 from vector<3xf32>
    %6 = vector.extract %2[1] : f32 from vector<3xf32>
    %7 = vector.extract %2[2] : f32 from vector<3xf32>
    %8 = arith.addf %5, %3 : f32
    %9 = arith.maxnumf %7, %3 : f32
    %10 = vector.from_elements %8, %6, %9 : vector<3xf32>
    tai.store %10, @v[%1] : vector<3xf32>
  }
  tai.return
}

// A component of the loaded vector is stored alone.
// CHECK-LABEL: tai.kernel @component
//       CHECK: tai.atomic add %{{.*}}, @v[%{{.*}}] component[%c2] : f32
//   CHECK-NOT: tai.store
//       CHECK: tai.return
tai.kernel @component() {
  %two = arith.constant 2 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @v[%1] : vector<3xf32>
    %3 = tai.load @x[%i] : f32
    %4 = vector.extract %2[2] : f32 from vector<3xf32>
    %5 = arith.addf %3, %4 : f32
    tai.store %5, @v[%1] component[%two] : f32
  }
  tai.return
}

// Another store writes a component whose former value this one restores.
// CHECK-LABEL: tai.kernel @restored
//       CHECK: tai.store %{{.*}}, @v[%{{.*}}] component[%c0] : f32
//       CHECK: tai.store %{{.*}}, @v[%{{.*}}] : vector<3xf32>
tai.kernel @restored() {
  %zero = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @v[%1] : vector<3xf32>
    %3 = tai.load @x[%i] : f32
    tai.store %3, @v[%1] component[%zero] : f32
    %4 = vector.extract %2[1] : f32 from vector<3xf32>
    %5 = arith.addf %4, %3 : f32
    %6 = vector.insert %5, %2[1] : f32 into vector<3xf32>
    tai.store %6, @v[%1] : vector<3xf32>
  }
  tai.return
}

// The element belongs to the iteration.
// CHECK-LABEL: tai.kernel @own
//       CHECK: tai.load @v[%{{.*}}] : vector<3xf32>
//       CHECK: tai.store %{{.*}}, @v[%{{.*}}] : vector<3xf32>
tai.kernel @own() {
  tai.parallel_for (%i) in @v {
    %2 = tai.load @v[%i] : vector<3xf32>
    %4 = vector.extract %2[1] : f32 from vector<3xf32>
    %5 = arith.addf %4, %4 : f32
    %6 = vector.insert %5, %2[1] : f32 into vector<3xf32>
    tai.store %6, @v[%i] : vector<3xf32>
  }
  tai.return
}

// A branch changes one component, and a later one another: each is an update
// where it happens.
// CHECK-LABEL: tai.kernel @branches
//   CHECK-NOT: tai.load @v
//       CHECK: scf.if
//       CHECK:   tai.atomic add %{{.*}}, @v[%{{.*}}] component[%c1] : f32
//       CHECK: scf.if
//       CHECK:   tai.atomic add %{{.*}}, @v[%{{.*}}] component[%c1] : f32
//       CHECK: } else {
//       CHECK:   tai.atomic add %{{.*}}, @v[%{{.*}}] component[%c2] : f32
//   CHECK-NOT: tai.store
//       CHECK: tai.return
tai.kernel @branches(%p: i1, %q: i1) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @v[%1] : vector<3xf32>
    %3 = tai.load @x[%i] : f32
    %4 = scf.if %p -> (vector<3xf32>) {
      %5 = vector.extract %2[1] : f32 from vector<3xf32>
      %6 = arith.addf %5, %3 : f32
      %7 = vector.insert %6, %2[1] : f32 into vector<3xf32>
      scf.yield %7 : vector<3xf32>
    } else {
      scf.yield %2 : vector<3xf32>
    }
    %8 = scf.if %q -> (vector<3xf32>) {
      %9 = vector.extract %4[1] : f32 from vector<3xf32>
      %10 = arith.addf %9, %3 : f32
      %11 = vector.insert %10, %4[1] : f32 into vector<3xf32>
      scf.yield %11 : vector<3xf32>
    } else {
      %9 = vector.extract %4[2] : f32 from vector<3xf32>
      %10 = arith.addf %9, %3 : f32
      %11 = vector.insert %10, %4[2] : f32 into vector<3xf32>
      scf.yield %11 : vector<3xf32>
    }
    tai.store %8, @v[%1] : vector<3xf32>
  }
  tai.return
}

// The other side is another vector.
// CHECK-LABEL: tai.kernel @other_vector
//       CHECK: tai.load @v[%{{.*}}] : vector<3xf32>
//   CHECK-NOT: tai.atomic
//       CHECK: tai.store %{{.*}}, @v[%{{.*}}] : vector<3xf32>
tai.kernel @other_vector(%p: i1, %w: vector<3xf32>) {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @v[%1] : vector<3xf32>
    %3 = tai.load @x[%i] : f32
    %4 = scf.if %p -> (vector<3xf32>) {
      %5 = vector.extract %2[1] : f32 from vector<3xf32>
      %6 = arith.addf %5, %3 : f32
      %7 = vector.insert %6, %2[1] : f32 into vector<3xf32>
      scf.yield %7 : vector<3xf32>
    } else {
      scf.yield %w : vector<3xf32>
    }
    tai.store %4, @v[%1] : vector<3xf32>
  }
  tai.return
}

// A serial loop carries the component that a branch in it changes.
// CHECK-LABEL: tai.kernel @in_loop
//   CHECK-NOT: tai.load @v
//       CHECK: %[[TOTAL:.*]] = scf.for {{.*}} -> (f32) {
//       CHECK: tai.atomic add %[[TOTAL]], @v[%{{.*}}] component[%c1] : f32
//   CHECK-NOT: tai.atomic
//   CHECK-NOT: tai.store
//       CHECK: tai.return
tai.kernel @in_loop(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @v[%1] : vector<3xf32>
    %3 = tai.load @x[%i] : f32
    %4 = scf.for %k = %c0 to %n step %c1 iter_args(%e = %2) -> vector<3xf32> {
      %even = arith.cmpi ult, %k, %1 : index
      %5 = scf.if %even -> vector<3xf32> {
        %6 = vector.extract %e[1] : f32 from vector<3xf32>
        %7 = arith.addf %6, %3 : f32
        %8 = vector.insert %7, %e[1] : f32 into vector<3xf32>
        scf.yield %8 : vector<3xf32>
      } else {
        scf.yield %e : vector<3xf32>
      }
      scf.yield %5 : vector<3xf32>
    }
    tai.store %4, @v[%1] : vector<3xf32>
  }
  tai.return
}

// A trip takes the component of the loaded vector: the last one counts.
// CHECK-LABEL: tai.kernel @last_trip
//   CHECK-NOT: tai.atomic
//       CHECK: tai.return
tai.kernel @last_trip(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @v[%1] : vector<3xf32>
    %3 = tai.load @x[%i] : f32
    %4 = scf.for %k = %c0 to %n step %c1 iter_args(%e = %2) -> vector<3xf32> {
      %6 = vector.extract %2[1] : f32 from vector<3xf32>
      %7 = arith.addf %6, %3 : f32
      %8 = vector.insert %7, %2[1] : f32 into vector<3xf32>
      scf.yield %8 : vector<3xf32>
    }
    tai.store %4, @v[%1] : vector<3xf32>
  }
  tai.return
}
