// RUN: tai-opt %s --tai-recognize-reductions --canonicalize | FileCheck %s

// A minimum or a maximum under conditions, in the forms that a program gives it.

!t = !tai.root<dense<[i: 64], {x: f32, n: i32, b: i32, p: i1, q: i1}>, dense<[i: 8], {h: f32, k: i32, s: i16, w: f16}>, dense<[i: 8], {far: i32}>>
tai.tree @t : !t
tai.field @x = @t["x"] : f32, rank 1
tai.field @n = @t["n"] : i32, rank 1
tai.field @b = @t["b"] : i32, rank 1
tai.field @p = @t["p"] : i1, rank 1
tai.field @q = @t["q"] : i1, rank 1
tai.field @h = @t["h"] : f32, rank 1
tai.field @k = @t["k"] : i32, rank 1
tai.field @s = @t["s"] : i16, rank 1
tai.field @w = @t["w"] : f16, rank 1
tai.field @far = @t["far"] : i32, rank 1

// h = x if (p and x < h) else h, where the comparison and the value are in branches.
// CHECK-LABEL: tai.kernel @branch
// CHECK: %[[P:.*]] = tai.load @p
// CHECK: scf.if %[[P]] {
// CHECK-NOT: tai.load @h
// CHECK: tai.atomic min %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @branch() {
  %false = arith.constant false
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %0 = scf.if %p -> (i1) {
      %1 = tai.load @x[%i] : f32
      %2 = tai.load @b[%i] : i32
      %3 = arith.index_cast %2 : i32 to index
      %4 = tai.load @h[%3] : f32
      %5 = arith.cmpf olt, %1, %4 : f32
      scf.yield %5 : i1
    } else {
      scf.yield %false : i1
    }
    %6 = scf.if %0 -> (f32) {
      %1 = tai.load @x[%i] : f32
      scf.yield %1 : f32
    } else {
      %2 = tai.load @b[%i] : i32
      %3 = arith.index_cast %2 : i32 to index
      %4 = tai.load @h[%3] : f32
      scf.yield %4 : f32
    }
    %7 = tai.load @b[%i] : i32
    %8 = arith.index_cast %7 : i32 to index
    tai.store %6, @h[%8] : f32
  }
  tai.return
}

// h = h if (p or not (x > h)) else x.
// CHECK-LABEL: tai.kernel @negated
// CHECK: %[[P:.*]] = tai.load @p
// CHECK: scf.if %[[P]] {
// CHECK-NEXT: } else {
// CHECK-NEXT: tai.atomic max %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @negated() {
  %true = arith.constant true
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.cmpf ogt, %x, %h : f32
    %1 = arith.xori %0, %true : i1
    %2 = arith.ori %p, %1 : i1
    %3 = arith.select %2, %h, %x : f32
    tai.store %3, @h[%j] : f32
  }
  tai.return
}

// if (p and x < h) or (q and h >= x): h = x
// CHECK-LABEL: tai.kernel @distributed
// CHECK: arith.ori
// CHECK: scf.if
// CHECK: tai.atomic min %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.return
tai.kernel @distributed() {
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %q = tai.load @q[%i] : i1
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.cmpf olt, %x, %h : f32
    %1 = arith.andi %0, %p : i1
    %2 = arith.cmpf oge, %h, %x : f32
    %3 = arith.andi %2, %q : i1
    %4 = arith.ori %1, %3 : i1
    scf.if %4 {
      tai.store %x, @h[%j] : f32
    }
  }
  tai.return
}

// A later condition reads where the field has an element for each iteration, or where it may not.
// CHECK-LABEL: tai.kernel @later_conditions
// CHECK: tai.atomic min %{{.*}}, @h[%{{.*}}] : f32
// CHECK-NOT: tai.store
// CHECK: tai.parallel_for
// CHECK-NOT: tai.atomic
// CHECK: tai.store
// CHECK: tai.return
tai.kernel @later_conditions() {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %zero = arith.constant 0 : i32
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.cmpf olt, %x, %h : f32
    scf.if %0 {
      %n = tai.load @n[%i] : i32
      %1 = arith.cmpi sgt, %n, %zero : i32
      scf.if %1 {
        tai.store %x, @h[%j] : f32
      }
    }
  }
  tai.parallel_for (%i) = (%c0) to (%c64) {
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.cmpf olt, %x, %h : f32
    scf.if %0 {
      %n = tai.load @far[%i] : i32
      %1 = arith.cmpi sgt, %n, %zero : i32
      scf.if %1 {
        tai.store %x, @h[%j] : f32
      }
    }
  }
  tai.return
}

// The element and the number are made wide to be compared. A float is rounded
// when it is stored, which keeps the order; an integer must fit.
// CHECK-LABEL: tai.kernel @narrow
// CHECK: tai.atomic maxu %{{.*}}, @s[%{{.*}}] : i16
// CHECK: tai.atomic max %c5_i16, @s[%{{.*}}] : i16
// CHECK: tai.atomic min %{{.*}}, @w[%{{.*}}] : f16
// CHECK: tai.parallel_for
// CHECK-NOT: tai.atomic
// CHECK: tai.return
tai.kernel @narrow() {
  %five = arith.constant 5 : i16
  %wide_five = arith.constant 5 : i32
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %n = tai.load @n[%i] : i32
    %m = arith.trunci %n : i32 to i16
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %s = tai.load @s[%j] : i16
    %0 = arith.extui %s : i16 to i32
    %1 = arith.extui %m : i16 to i32
    %2 = arith.maxsi %0, %1 : i32
    %3 = arith.trunci %2 : i32 to i16
    tai.store %3, @s[%j] : i16
  }
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %s = tai.load @s[%j] : i16
    %0 = arith.extsi %s : i16 to i32
    %1 = arith.cmpi slt, %0, %wide_five : i32
    %2 = arith.andi %1, %p : i1
    scf.if %2 {
      tai.store %five, @s[%j] : i16
    }
    %x = tai.load @x[%i] : f32
    %w = tai.load @w[%j] : f16
    %3 = arith.extf %w : f16 to f32
    %4 = arith.cmpf olt, %x, %3 : f32
    %5 = arith.andi %4, %p : i1
    %6 = arith.select %5, %x, %3 : f32
    %7 = arith.truncf %6 : f32 to f16
    tai.store %7, @w[%j] : f16
  }
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %n = tai.load @n[%i] : i32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %s = tai.load @s[%j] : i16
    %0 = arith.extsi %s : i16 to i32
    %1 = arith.cmpi slt, %0, %n : i32
    %2 = arith.andi %1, %p : i1
    %3 = arith.select %2, %n, %0 : i32
    %4 = arith.trunci %3 : i32 to i16
    tai.store %4, @s[%j] : i16
  }
  tai.return
}

// No minimum: the element becomes the number whatever it was; it is compared
// with another number; with two numbers; an extremum of two kinds; an element
// that is NaN is replaced.
// CHECK-LABEL: tai.kernel @others
// CHECK-NOT: tai.atomic
// CHECK: tai.return
tai.kernel @others() {
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.cmpf olt, %x, %h : f32
    %1 = arith.ori %0, %p : i1
    %2 = arith.select %1, %x, %h : f32
    tai.store %2, @h[%j] : f32
  }
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.addf %x, %one : f32
    %1 = arith.cmpf olt, %0, %h : f32
    %2 = arith.andi %1, %p : i1
    %3 = arith.select %2, %x, %h : f32
    tai.store %3, @h[%j] : f32
  }
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.addf %x, %one : f32
    %1 = arith.cmpf olt, %0, %h : f32
    %2 = arith.cmpf olt, %x, %h : f32
    %3 = arith.select %1, %0, %h : f32
    %4 = arith.select %2, %x, %3 : f32
    tai.store %4, @h[%j] : f32
  }
  tai.parallel_for (%i) in @x {
    %p = tai.load @p[%i] : i1
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.cmpf olt, %x, %h : f32
    %1 = arith.cmpf ogt, %x, %h : f32
    %2 = arith.select %p, %0, %1 : i1
    scf.if %2 {
      tai.store %x, @h[%j] : f32
    }
  }
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f32
    %b = tai.load @b[%i] : i32
    %j = arith.index_cast %b : i32 to index
    %h = tai.load @h[%j] : f32
    %0 = arith.cmpf olt, %x, %h : f32
    %1 = arith.cmpf uno, %h, %h : f32
    %2 = arith.ori %0, %1 : i1
    scf.if %2 {
      tai.store %x, @h[%j] : f32
    }
  }
  tai.return
}
