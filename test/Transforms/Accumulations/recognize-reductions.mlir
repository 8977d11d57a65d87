// RUN: tai-opt %s --tai-recognize-reductions --canonicalize --split-input-file | FileCheck %s

// Loads and stores of an element that other iterations update, too, become an
// atomic where all that lies between is one operation that atomics have.

!t = !tai.root<dense<[i: 64], {x: f32, n: i32, b: i32, v: vector<2xf32>}>, dense<[i: 8], {h: f32, k: i32, s: i8, w: f16}>, {o: f32, c: i32, u: vector<2xf32>, d: f64}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 1
tai.field @b = @t["b"] : i32, rank 1
tai.field @v = @t["v"] : vector<2xf32>, rank 1
tai.field @h = @t["h"] : f32, rank 1
tai.field @k = @t["k"] : i32, rank 1
tai.field @s = @t["s"] : i8, rank 1
tai.field @w = @t["w"] : f16, rank 1
tai.field @o = @t["o"] : f32, rank 0
tai.field @c = @t["c"] : i32, rank 0
tai.field @u = @t["u"] : vector<2xf32>, rank 0
tai.field @d = @t["d"] : f64, rank 0

// CHECK-LABEL: tai.kernel @sum
// CHECK-NOT: tai.load @o
// CHECK: tai.atomic add %{{.*}}, @o[] : f32
// CHECK-NOT: tai.store
tai.kernel @sum() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @o[] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @o[] : f32
  }
  tai.return
}

// The element less a, plus b, is one addition; what is taken from the element
// is a difference.
// CHECK-LABEL: tai.kernel @chain
// CHECK: %[[A:.*]] = tai.load @x
// CHECK: %[[B:.*]] = arith.mulf %[[A]], %[[A]]
// CHECK: %[[D:.*]] = arith.subf %[[B]], %[[A]]
// CHECK: tai.atomic add %[[D]], @o[]
// CHECK: tai.atomic sub %{{.*}}, @d[]
// CHECK-NOT: tai.store
tai.kernel @chain() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    %2 = tai.load @o[] : f32
    %3 = arith.subf %2, %0 : f32
    %4 = arith.addf %1, %3 : f32
    tai.store %4, @o[] : f32
    %5 = tai.load @d[] : f64
    %6 = arith.extf %0 : f32 to f64
    %7 = arith.subf %5, %6 : f64
    tai.store %7, @d[] : f64
  }
  tai.return
}

// The index is read from a field, twice.
// CHECK-LABEL: tai.kernel @histogram
// CHECK: tai.atomic mul %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
tai.kernel @histogram() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @b[%i] : i32
    %2 = arith.index_cast %1 : i32 to index
    %3 = tai.load @h[%2] : f32
    %4 = arith.mulf %3, %0 : f32
    %5 = tai.load @b[%i] : i32
    %6 = arith.index_cast %5 : i32 to index
    tai.store %4, @h[%6] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @conditional
// CHECK: scf.if
// CHECK: tai.atomic add %{{.*}}, @c[] : i32
// CHECK-NOT: tai.store
tai.kernel @conditional() {
  %zero = arith.constant 0.0 : f32
  %two = arith.constant 2 : i32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.cmpf ogt, %0, %zero : f32
    scf.if %1 {
      %2 = tai.load @c[] : i32
      %3 = arith.addi %2, %two : i32
      tai.store %3, @c[] : i32
    }
  }
  tai.return
}

// Conditions in branches of each other hold together where the later ones can
// be computed anyhow. An element that is read only where the first one holds may
// lie outside its field.
// CHECK-LABEL: tai.kernel @several_conditions
// CHECK: tai.parallel_for
// CHECK: %[[A:.*]] = tai.load @x[%{{.*}}] : f32
// CHECK: %[[P:.*]] = arith.cmpf ogt, %{{.*}}, %{{.*}}
// CHECK: scf.if %[[P]] {
// CHECK-NEXT: tai.atomic min %[[A]], @o[]
// CHECK: tai.parallel_for
// CHECK: scf.if
// CHECK: tai.atomic min %{{.*}}, @o[]
// CHECK: tai.parallel_for
// CHECK-NOT: tai.atomic
// CHECK: scf.if
// CHECK: tai.store
tai.kernel @several_conditions() {
  %zero = arith.constant 0.0 : f32
  %false = arith.constant false
  tai.parallel_for (%i) in @x {
    %0 = tai.load @o[] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.cmpf ogt, %0, %1 : f32
    %3 = scf.if %2 -> (i1) {
      %4 = tai.load @x[%i] : f32
      %5 = arith.cmpf ogt, %4, %zero : f32
      scf.yield %5 : i1
    } else {
      scf.yield %false : i1
    }
    scf.if %3 {
      %4 = tai.load @x[%i] : f32
      tai.store %4, @o[] : f32
    }
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @o[] : f32
    %2 = arith.cmpf olt, %0, %1 : f32
    scf.if %2 {
      %3 = tai.load @n[%i] : i32
      %4 = arith.index_cast %3 : i32 to index
      %5 = arith.index_cast %4 : index to i32
      %6 = arith.sitofp %5 : i32 to f32
      %7 = arith.cmpf ogt, %6, %zero : f32
      scf.if %7 {
        tai.store %0, @o[] : f32
      }
    }
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @n[%i] : i32
    %1 = tai.load @c[] : i32
    %2 = arith.cmpi eq, %0, %1 : i32
    scf.if %2 {
      %3 = arith.index_cast %0 : i32 to index
      %4 = tai.load @n[%3] : i32
      %5 = arith.cmpi slt, %4, %1 : i32
      scf.if %5 {
        tai.store %4, @c[] : i32
      }
    }
  }
  tai.return
}

// A choice between two sums, by a select and by a branch.
// CHECK-LABEL: tai.kernel @choices
// CHECK: %[[X:.*]] = tai.load @x
// CHECK: %[[P:.*]] = arith.cmpf ogt, %[[X]]
// CHECK: scf.if %[[P]] {
// CHECK: tai.atomic add %[[X]], @o[]
// CHECK: tai.atomic or
// CHECK: } else {
// CHECK: tai.atomic or
// CHECK: }
// CHECK-NOT: tai.store
tai.kernel @choices() {
  %zero = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.cmpf ogt, %0, %zero : f32
    %2 = tai.load @o[] : f32
    %3 = arith.addf %2, %0 : f32
    %4 = tai.load @o[] : f32
    %5 = arith.select %1, %3, %4 : f32
    tai.store %5, @o[] : f32
    %6 = scf.if %1 -> i32 {
      %7 = tai.load @n[%i] : i32
      %8 = tai.load @c[] : i32
      %9 = arith.ori %8, %7 : i32
      scf.yield %9 : i32
    } else {
      %7 = tai.load @b[%i] : i32
      %8 = tai.load @c[] : i32
      %9 = arith.ori %7, %8 : i32
      scf.yield %9 : i32
    }
    tai.store %6, @c[] : i32
  }
  tai.return
}

// Extrema by their ops, by a select, by a branch that yields, by a branch
// around the store; the value is read twice.
// CHECK-LABEL: tai.kernel @extrema
// CHECK: tai.atomic max %{{.*}}, @o[]
// CHECK: tai.atomic max %{{.*}}, @o[]
// CHECK: tai.atomic max %{{.*}}, @o[]
// CHECK: tai.atomic max %{{.*}}, @o[]
// CHECK: tai.atomic minu %{{.*}}, @c[]
// CHECK-NOT: tai.store
tai.kernel @extrema() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @o[] : f32
    %2 = arith.maxnumf %1, %0 : f32
    tai.store %2, @o[] : f32
    %3 = tai.load @o[] : f32
    %4 = arith.cmpf olt, %3, %0 : f32
    %5 = tai.load @o[] : f32
    %6 = arith.select %4, %0, %5 : f32
    tai.store %6, @o[] : f32
    %7 = tai.load @x[%i] : f32
    %8 = tai.load @o[] : f32
    %9 = arith.cmpf ogt, %7, %8 : f32
    %10 = scf.if %9 -> f32 {
      %11 = tai.load @x[%i] : f32
      scf.yield %11 : f32
    } else {
      %11 = tai.load @o[] : f32
      scf.yield %11 : f32
    }
    tai.store %10, @o[] : f32
    %12 = tai.load @o[] : f32
    %13 = arith.cmpf ogt, %7, %12 : f32
    scf.if %13 {
      %14 = tai.load @x[%i] : f32
      tai.store %14, @o[] : f32
    }
    %15 = tai.load @n[%i] : i32
    %16 = tai.load @c[] : i32
    %17 = arith.minui %16, %15 : i32
    tai.store %17, @c[] : i32
  }
  tai.return
}

// Another condition beside the comparison remains.
// CHECK-LABEL: tai.kernel @guarded
// CHECK: %[[Q:.*]] = arith.cmpi sgt
// CHECK: scf.if %[[Q]] {
// CHECK: tai.atomic min %{{.*}}, @o[]
// CHECK-NOT: tai.store
tai.kernel @guarded() {
  %zero = arith.constant 0 : i32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @o[] : f32
    %2 = arith.cmpf olt, %0, %1 : f32
    %3 = tai.load @n[%i] : i32
    %4 = arith.cmpi sgt, %3, %zero : i32
    %5 = arith.andi %2, %4 : i1
    scf.if %5 {
      tai.store %0, @o[] : f32
    }
  }
  tai.return
}

// Vectors, components, elements that are computed in a wider type, arrays.
// CHECK-LABEL: tai.kernel @types
// CHECK: tai.atomic add %{{.*}}, @u[] : vector<2xf32>
// CHECK: tai.atomic mul %{{.*}}, @u[] component[%{{.*}}] : f32
// CHECK: arith.truncf
// CHECK: tai.atomic add %{{.*}}, @w[%{{.*}}] : f16
// CHECK: arith.trunci
// CHECK: tai.atomic xor %{{.*}}, @s[%{{.*}}] : i8
// CHECK: memref.atomic_rmw mulf
// CHECK: memref.atomic_rmw maxs
// CHECK-NOT: memref.store
tai.kernel @types(%a: memref<?xf32>, %m: memref<?xi32>) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @v[%i] : vector<2xf32>
    %1 = tai.load @u[] : vector<2xf32>
    %2 = arith.addf %1, %0 : vector<2xf32>
    tai.store %2, @u[] : vector<2xf32>
  }
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %0 = tai.load @u[] component [%c0] : f32
    %1 = arith.mulf %0, %x : f32
    tai.store %1, @u[] component [%c0] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %2 = tai.load @w[%j] : f16
    %3 = arith.extf %2 : f16 to f32
    %4 = arith.addf %3, %x : f32
    %5 = arith.truncf %4 : f32 to f16
    tai.store %5, @w[%j] : f16
    %6 = tai.load @s[%j] : i8
    %7 = arith.extsi %6 : i8 to i32
    %8 = arith.xori %7, %b : i32
    %9 = arith.trunci %8 : i32 to i8
    tai.store %9, @s[%j] : i8
    %10 = memref.load %a[%j] : memref<?xf32>
    %11 = arith.mulf %x, %10 : f32
    memref.store %11, %a[%j] : memref<?xf32>
    %12 = memref.load %m[%c0] : memref<?xi32>
    %13 = arith.cmpi sgt, %12, %b : i32
    %14 = arith.select %13, %12, %b : i32
    memref.store %14, %m[%c0] : memref<?xi32>
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @inner_loop
// CHECK: scf.for
// CHECK: tai.atomic add %{{.*}}, @o[]
// CHECK-NOT: tai.store
tai.kernel @inner_loop() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    scf.for %j = %c0 to %c4 step %c1 {
      %1 = tai.load @o[] : f32
      %2 = arith.addf %1, %0 : f32
      tai.store %2, @o[] : f32
    }
  }
  tai.return
}

// -----

// Elements of one iteration keep their loads and stores; so do updates that are
// no reductions where the iterations may be apart, and all in serial code.

!t = !tai.root<dense<[i: 64], {x: f32, b: i32, h: f32}>, {o: f32}>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @b = @t["b"] : i32, rank 1
tai.field @h = @t["h"] : f32, rank 1
tai.field @o = @t["o"] : f32, rank 0

// CHECK-LABEL: tai.kernel @own
// CHECK-NOT: tai.atomic
tai.kernel @own(%k: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.addf %0, %0 : f32
    tai.store %1, @x[%i] : f32
    // One iteration alone.
    %2 = arith.cmpi eq, %i, %k : index
    scf.if %2 {
      %3 = tai.load @o[] : f32
      %4 = arith.addf %3, %0 : f32
      tai.store %4, @o[] : f32
    }
  }
  tai.parallel_for (%i) = (%c0) to (%c1) {
    %0 = tai.load @o[] : f32
    %1 = arith.addf %0, %0 : f32
    tai.store %1, @o[] : f32
  }
  tai.parallel_for (%i) in @x {
    %2 = arith.cmpi slt, %i, %c1 : index
    scf.if %2 {
      %0 = tai.load @o[] : f32
      %1 = arith.addf %0, %0 : f32
      tai.store %1, @o[] : f32
    }
  }
  tai.parallel_for (%i) = (%c0) to (%c8) serialize {
    %0 = tai.load @o[] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @o[] : f32
  }
  scf.for %i = %c0 to %c8 step %c1 {
    %0 = tai.load @o[] : f32
    %1 = tai.load @x[%i] : f32
    %2 = arith.addf %0, %1 : f32
    tai.store %2, @o[] : f32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @possibly_shared
// CHECK-NOT: tai.atomic
tai.kernel @possibly_shared() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @x[%i] : f32
    %3 = tai.load @h[%1] : f32
    %4 = arith.subf %2, %3 : f32
    tai.store %4, @h[%1] : f32
  }
  // The value that was there is used otherwise.
  tai.parallel_for (%i) in @x {
    %0 = tai.load @b[%i] : i32
    %1 = arith.index_cast %0 : i32 to index
    %2 = tai.load @h[%1] : f32
    %3 = arith.addf %2, %2 : f32
    tai.store %3, @h[%1] : f32
    tai.store %2, @x[%i] : f32
  }
  tai.return
}

// All iterations that store at all store the same; with a comparison it is an
// extremum.
// CHECK-LABEL: tai.kernel @flag
// CHECK: tai.atomic max %{{.*}}, @o[]
// CHECK: tai.store
tai.kernel @flag() {
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @o[] : f32
    %1 = arith.cmpf olt, %0, %one : f32
    scf.if %1 {
      tai.store %one, @o[] : f32
    }
  }
  tai.parallel_for (%i) in @x {
    %0 = tai.load @o[] : f32
    %1 = arith.cmpf une, %0, %one : f32
    scf.if %1 {
      tai.store %one, @o[] : f32
    }
  }
  tai.return
}

// -----

!t = !tai.root<dense<[i: 64], {x: f32, n: i32, b: i32}>, dense<[i: 8], {h: f32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 1
tai.field @b = @t["b"] : i32, rank 1
tai.field @h = @t["h"] : f32, rank 1

// A comparison behind another condition, which guards what is read: the branch
// keeps that condition.
// CHECK-LABEL: tai.kernel @behind_a_condition
// CHECK: %[[C:.*]] = arith.cmpf ogt
// CHECK: scf.if %[[C]] {
// CHECK: tai.atomic min %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @behind_a_condition() {
  %false = arith.constant false
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.cmpf ogt, %0, %one : f32
    %2 = scf.if %1 -> (i1) {
      %3 = tai.load @b[%i] : i32
      %4 = arith.index_cast %3 : i32 to index
      %5 = tai.load @h[%4] : f32
      %6 = arith.cmpf olt, %0, %5 : f32
      scf.yield %6 : i1
    } else {
      scf.yield %false : i1
    }
    scf.if %2 {
      %3 = tai.load @b[%i] : i32
      %4 = arith.index_cast %3 : i32 to index
      tai.store %0, @h[%4] : f32
    }
  }
  tai.return
}

// Not if the condition decides on something else, too.
// CHECK-LABEL: tai.kernel @behind_a_shared_condition
// CHECK-NOT: tai.atomic
// CHECK: tai.return
tai.kernel @behind_a_shared_condition() {
  %false = arith.constant false
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.cmpf ogt, %0, %one : f32
    %2 = scf.if %1 -> (i1) {
      %3 = tai.load @b[%i] : i32
      %4 = arith.index_cast %3 : i32 to index
      %5 = tai.load @h[%4] : f32
      %6 = arith.cmpf olt, %0, %5 : f32
      scf.yield %6 : i1
    } else {
      scf.yield %false : i1
    }
    scf.if %2 {
      %3 = tai.load @b[%i] : i32
      %4 = arith.index_cast %3 : i32 to index
      tai.store %0, @h[%4] : f32
    }
    scf.if %2 {
      tai.store %one, @x[%i] : f32
    }
  }
  tai.return
}

// Elements that are an iteration's own by each index alone, but not by both.
// CHECK-LABEL: tai.kernel @own_by_either_index
// CHECK: tai.atomic max %{{.*}}, @n[%{{.*}}] : i32
// CHECK: tai.atomic max %{{.*}}, @n[%{{.*}}] : i32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @own_by_either_index() {
  %c1 = arith.constant 1 : index
  %c63 = arith.constant 63 : index
  tai.parallel_for (%i) = (%c1) to (%c63) {
    %0 = arith.index_cast %i : index to i32
    %1 = tai.load @n[%i] : i32
    %2 = arith.maxsi %1, %0 : i32
    tai.store %2, @n[%i] : i32
    %j = arith.addi %i, %c1 : index
    %3 = tai.load @n[%j] : i32
    %4 = arith.maxsi %3, %0 : i32
    tai.store %4, @n[%j] : i32
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @own_beside_shared
// CHECK: tai.atomic mul %{{.*}}, @h[%{{.*}}] : f32
// CHECK: tai.atomic mul %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @own_beside_shared() {
  %c0 = arith.constant 0 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) = (%c0) to (%c8) {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @h[%i] : f32
    %2 = arith.mulf %1, %0 : f32
    tai.store %2, @h[%i] : f32
    %3 = tai.load @b[%i] : i32
    %j = arith.index_cast %3 : i32 to index
    %4 = tai.load @h[%j] : f32
    %5 = arith.mulf %4, %0 : f32
    tai.store %5, @h[%j] : f32
  }
  tai.return
}

// Elements that no iteration shares keep their stores.
// CHECK-LABEL: tai.kernel @halves
// CHECK-NOT: tai.atomic
// CHECK: tai.return
tai.kernel @halves() {
  %c0 = arith.constant 0 : index
  %c32 = arith.constant 32 : index
  tai.parallel_for (%i) = (%c0) to (%c32) {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @x[%i] : f32
    %j = arith.addi %i, %c32 : index
    %2 = tai.load @x[%j] : f32
    %3 = arith.addf %2, %2 : f32
    tai.store %3, @x[%j] : f32
  }
  tai.return
}

// The compared value is loaded twice; the loop writes it, but not in between.
// CHECK-LABEL: tai.kernel @written_before
// CHECK: tai.store %{{.*}}, @x
// CHECK: tai.atomic max %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @written_before() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @x[%i] : f32
    %2 = tai.load @b[%i] : i32
    %j = arith.index_cast %2 : i32 to index
    %3 = tai.load @x[%i] : f32
    %4 = tai.load @h[%j] : f32
    %5 = arith.cmpf ogt, %3, %4 : f32
    scf.if %5 {
      %6 = tai.load @x[%i] : f32
      tai.store %6, @h[%j] : f32
    }
  }
  tai.return
}

// CHECK-LABEL: tai.kernel @written_between
// CHECK-NOT: tai.atomic
// CHECK: tai.return
tai.kernel @written_between() {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %2 = tai.load @b[%i] : i32
    %j = arith.index_cast %2 : i32 to index
    %4 = tai.load @h[%j] : f32
    %5 = arith.cmpf ogt, %0, %4 : f32
    %1 = arith.mulf %0, %0 : f32
    tai.store %1, @x[%i] : f32
    scf.if %5 {
      %6 = tai.load @x[%i] : f32
      tai.store %6, @h[%j] : f32
    }
  }
  tai.return
}

// A serial loop changes the loaded element: its total, from zero, is added.
// CHECK-LABEL: tai.kernel @loop
// CHECK-NOT: tai.load @h
// CHECK: %[[TOTAL:.*]] = scf.for {{.*}} iter_args(%[[PART:.*]] = %[[ZERO:.*]]) -> (f32) {
// CHECK: arith.subf %[[PART]]
// CHECK: tai.atomic add %[[TOTAL]], @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @loop(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @b[%i] : i32
    %j = arith.index_cast %1 : i32 to index
    %2 = tai.load @h[%j] : f32
    %3 = scf.for %k = %c0 to %n step %c1 iter_args(%e = %2) -> f32 {
      %4 = arith.subf %e, %0 : f32
      scf.yield %4 : f32
    }
    tai.store %3, @h[%j] : f32
  }
  tai.return
}

// Each trip begins with the loaded element again.
// CHECK-LABEL: tai.kernel @last_trip
// CHECK-NOT: tai.atomic
// CHECK: tai.return
tai.kernel @last_trip(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @b[%i] : i32
    %j = arith.index_cast %1 : i32 to index
    %2 = tai.load @h[%j] : f32
    %3 = scf.for %k = %c0 to %n step %c1 iter_args(%e = %2) -> f32 {
      %4 = arith.addf %2, %0 : f32
      scf.yield %4 : f32
    }
    tai.store %3, @h[%j] : f32
  }
  tai.return
}

// The number of trips comes from the element.
// CHECK-LABEL: tai.kernel @trips
// CHECK-NOT: tai.atomic
// CHECK: tai.return
tai.kernel @trips() {
  %cst = arith.constant 2.0 : f32
  %c0 = arith.constant 0 : i32
  %c1 = arith.constant 1 : i32
  tai.parallel_for (%i) in @x {
    %1 = tai.load @b[%i] : i32
    %j = arith.index_cast %1 : i32 to index
    %2 = tai.load @h[%j] : f32
    %n = arith.fptosi %2 : f32 to i32
    %3 = scf.for %k = %c0 to %n step %c1 iter_args(%e = %2) -> f32 : i32 {
      %4 = arith.addf %e, %cst : f32
      scf.yield %4 : f32
    }
    tai.store %3, @h[%j] : f32
  }
  tai.return
}

// One trip stores the part elsewhere.
// CHECK-LABEL: tai.kernel @part
// CHECK-NOT: tai.atomic
// CHECK: tai.return
tai.kernel @part(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @b[%i] : i32
    %j = arith.index_cast %1 : i32 to index
    %2 = tai.load @h[%j] : f32
    %3 = scf.for %k = %c0 to %n step %c1 iter_args(%e = %2) -> f32 {
      tai.store %e, @x[%i] : f32
      %4 = arith.addf %e, %0 : f32
      scf.yield %4 : f32
    }
    tai.store %3, @h[%j] : f32
  }
  tai.return
}

// A serial loop only hands the loaded element on.
// CHECK-LABEL: tai.kernel @handed_on
// CHECK-NOT: tai.load @h
// CHECK: tai.atomic add %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @handed_on(%n: index) {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    %1 = tai.load @b[%i] : i32
    %j = arith.index_cast %1 : i32 to index
    %2 = tai.load @h[%j] : f32
    %3 = scf.for %k = %c0 to %n step %c1 iter_args(%e = %2) -> f32 {
      scf.yield %e : f32
    }
    %4 = arith.addf %3, %0 : f32
    tai.store %4, @h[%j] : f32
  }
  tai.return
}
