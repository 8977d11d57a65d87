// RUN: tai-opt %s --tai-sink-adjoints --canonicalize --split-input-file | FileCheck %s

tai.tree @t : !tai.root<dense<[i: 64], {x: f64, gx: f64, gy: f64, s: f64, p: i32, v: vector<2xf64>}>>
tai.field @x = @t["x"] : f64, rank 1
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @s = @t["s"] : f64, rank 1
tai.field @p = @t["p"] : i32, rank 1
tai.field @v = @t["v"] : vector<2xf64>, rank 1

// All code behind it adds products of the branch's results.
// CHECK-LABEL: tai.kernel @scatter
//       CHECK:   tai.parallel_for
//       CHECK:     scf.if
//  CHECK-NEXT:       %[[G:.+]] = tai.load @gy
//  CHECK-NEXT:       %[[A:.+]] = arith.mulf %[[G]]
//  CHECK-NEXT:       %[[N:.+]] = arith.negf %[[A]]
//  CHECK-NEXT:       tai.atomic add %[[N]], @gx
//  CHECK-NEXT:       tai.atomic sub %[[A]], @gx
//  CHECK-NEXT:     }
//  CHECK-NEXT:   }
tai.kernel @scatter() {
  %zero = arith.constant 0.0 : f64
  %one = arith.constant 1 : index
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (f64) {
      %0 = tai.load @gy[%i] : f64
      scf.yield %0 : f64
    } else {
      scf.yield %zero : f64
    } {tai.adjoint_branch}
    %a = arith.mulf %g, %x : f64
    %n = arith.negf %a : f64
    tai.atomic add %n, @gx[%j] : f64
    tai.atomic sub %a, @gx[%i] : f64
  }
  tai.return
}

// The arm of the condition returns zeros; that of a vector, too.
// CHECK-LABEL: tai.kernel @other_arm
//       CHECK:   scf.if %{{.+}} {
//  CHECK-NEXT:   } else {
//       CHECK:     tai.atomic add %{{.+}}, @v
//       CHECK:   }
//   CHECK-NOT:   tai.atomic
tai.kernel @other_arm() {
  %zero = arith.constant 0.0 : f64
  %zeros = arith.constant dense<0.0> : vector<2xf64>
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (vector<2xf64>) {
      scf.yield %zeros : vector<2xf64>
    } else {
      %0 = tai.load @v[%i] : vector<2xf64>
      scf.yield %0 : vector<2xf64>
    } {tai.adjoint_branch}
    %b = vector.broadcast %x : f64 to vector<2xf64>
    %a = arith.mulf %b, %g : vector<2xf64>
    tai.atomic add %a, @v[%j] : vector<2xf64>
  }
  tai.return
}

// A carried value without an addition is unchanged, but for values from
// elsewhere.
// CHECK-LABEL: tai.kernel @carried
//       CHECK:   scf.for {{.*}} iter_args(%[[SUM:.+]] = %{{.+}}, %[[REST:.+]] = %{{.+}})
//       CHECK:     %[[R:.+]]:2 = scf.if
//       CHECK:       arith.mulf
//       CHECK:       tai.atomic add
//       CHECK:     } else {
//  CHECK-NEXT:       %[[S:.+]] = tai.load @s
//  CHECK-NEXT:       %[[NEXT:.+]] = arith.addf %[[REST]], %[[S]]
//  CHECK-NEXT:       scf.yield %[[SUM]], %[[NEXT]]
//       CHECK:     scf.yield %[[R]]#0, %[[R]]#1
tai.kernel @carried() {
  %zero = arith.constant 0.0 : f64
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c8 = arith.constant 8 : index
  tai.parallel_for (%i) in @x {
    %sums:2 = scf.for %k = %c0 to %c8 step %c1 iter_args(%sum = %zero, %rest = %zero) -> (f64, f64) {
      %x = tai.load @x[%k] : f64
      %c = arith.cmpf olt, %x, %zero : f64
      %g = scf.if %c -> (f64) {
        %0 = tai.load @gy[%k] : f64
        scf.yield %0 : f64
      } else {
        scf.yield %zero : f64
      } {tai.adjoint_branch}
      %s = tai.load @s[%k] : f64
      %a = arith.mulf %g, %s : f64
      %b = arith.addf %sum, %a : f64
      %d = arith.addf %rest, %s : f64
      tai.atomic add %a, @gx[%k] : f64
      scf.yield %b, %d : f64, f64
    }
    tai.atomic add %sums#0, @gx[%i] : f64
    tai.atomic add %sums#1, @gy[%i] : f64
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 64], {x: f64, gx: f64, gy: f64, p: i32}>>
tai.field @x = @t["x"] : f64, rank 1
tai.field @gx = @t["gx"] : f64, rank 1
tai.field @gy = @t["gy"] : f64, rank 1
tai.field @p = @t["p"] : i32, rank 1

// Something else is added, too; something is stored; both arms have adjoints; an
// old value is used; a quotient by zero is not zero.
// CHECK-LABEL: tai.kernel @stays
// CHECK-COUNT-5: {tai.adjoint_branch}
tai.kernel @stays() {
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (f64) {
      %0 = tai.load @gy[%i] : f64
      scf.yield %0 : f64
    } else {
      scf.yield %zero : f64
    } {tai.adjoint_branch}
    %a = arith.addf %g, %x : f64
    tai.atomic add %a, @gx[%j] : f64
  }
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (f64) {
      %0 = tai.load @gy[%i] : f64
      scf.yield %0 : f64
    } else {
      scf.yield %zero : f64
    } {tai.adjoint_branch}
    tai.atomic add %g, @gx[%j] : f64
    tai.store %g, @gy[%i] : f64
  }
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (f64) {
      %0 = tai.load @gy[%i] : f64
      scf.yield %0 : f64
    } else {
      scf.yield %x : f64
    } {tai.adjoint_branch}
    tai.atomic add %g, @gx[%j] : f64
  }
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (f64) {
      %0 = tai.load @gy[%i] : f64
      scf.yield %0 : f64
    } else {
      scf.yield %zero : f64
    } {tai.adjoint_branch}
    %old = tai.atomic add %g, @gx[%j] : f64
    tai.atomic add %old, @gy[%j] : f64
  }
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (f64) {
      %0 = tai.load @gy[%i] : f64
      scf.yield %0 : f64
    } else {
      scf.yield %zero : f64
    } {tai.adjoint_branch}
    %a = arith.divf %x, %g : f64
    tai.atomic add %a, @gx[%j] : f64
  }
  tai.return
}

// Without the mark nobody knows that zeros are adjoints; loops that may become
// vectors have no branches for the sake of these.
// CHECK-LABEL: tai.kernel @unmarked
//       CHECK:   %[[G:.+]] = scf.if
//       CHECK:   %[[A:.+]] = arith.mulf %[[G]]
//       CHECK:   tai.atomic add %[[A]]
//       CHECK:   %[[H:.+]] = scf.if
//       CHECK:   tai.adjoint_branch
//       CHECK:   %[[B:.+]] = arith.mulf %[[H]]
//       CHECK:   tai.atomic add %[[B]]
tai.kernel @unmarked() {
  %zero = arith.constant 0.0 : f64
  tai.parallel_for (%i) in @x {
    %k = tai.load @p[%i] : i32
    %j = arith.index_cast %k : i32 to index
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (f64) {
      %0 = tai.load @gy[%i] : f64
      scf.yield %0 : f64
    } else {
      scf.yield %zero : f64
    }
    %a = arith.mulf %g, %x : f64
    tai.atomic add %a, @gx[%j] : f64
  }
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %c = arith.cmpf olt, %x, %zero : f64
    %g = scf.if %c -> (f64) {
      %0 = tai.load @gy[%i] : f64
      scf.yield %0 : f64
    } else {
      scf.yield %zero : f64
    } {tai.adjoint_branch}
    %a = arith.mulf %g, %x : f64
    tai.atomic add %a, @gx[%i] exclusive : f64
  }
  tai.return
}
