// RUN: tai-run %s

// Polar, singular value and eigenvalue decompositions put together again, for
// random matrices and for those where formulas fail: the identity, zero, rank
// one and two, reflections, equal values. Rotations are rotations throughout.

tai.tree @t : !tai.root<
    dense<[i: 64], {a: vector<3x3xf64>, b: vector<2x2xf64>, s: vector<3x3xf32>}>,
    {e3: f64, e2: f64, ef: f32, es: f64, diag: f64}>
tai.field @a = @t["a"] : vector<3x3xf64>, rank 1
tai.field @b = @t["b"] : vector<2x2xf64>, rank 1
tai.field @s = @t["s"] : vector<3x3xf32>, rank 1
tai.field @e3 = @t["e3"] : f64, rank 0
tai.field @e2 = @t["e2"] : f64, rank 0
tai.field @ef = @t["ef"] : f32, rank 0
tai.field @es = @t["es"] : f64, rank 0
tai.field @diag = @t["diag"] : f64, rank 0

tai.kernel @fill() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c6 = arith.constant 6 : index
  %half = arith.constant 0.5 : f64
  tai.parallel_for (%i) in @a {
    scf.for %j = %c0 to %c3 step %c1 {
      scf.for %k = %c0 to %c3 step %c1 {
        %0 = tai.random stream 0 : f64
        %1 = arith.subf %0, %half : f64
        tai.store %1, @a[%i] component [%j, %k] : f64
        %j2 = arith.cmpi ult, %j, %c2 : index
        %k2 = arith.cmpi ult, %k, %c2 : index
        %inside = arith.andi %j2, %k2 : i1
        scf.if %inside {
          tai.store %1, @b[%i] component [%j, %k] : f64
        }
      }
    }
  }
  %i3 = arith.constant dense<[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]> : vector<3x3xf64>
  %z3 = arith.constant dense<0.0> : vector<3x3xf64>
  %r3 = arith.constant dense<[[3.0, 2.0, 1.0], [6.0, 4.0, 2.0], [9.0, 6.0, 3.0]]> : vector<3x3xf64>
  %d3 = arith.constant dense<[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]> : vector<3x3xf64>
  %m3 = arith.constant dense<[[3.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 2.0]]> : vector<3x3xf64>
  %n3 = arith.constant dense<[[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]> : vector<3x3xf64>
  %t3 = arith.constant dense<[[1.0e-200, 0.0, 1.0e-201], [0.0, 2.0e-200, 0.0], [0.0, 0.0, 1.0e-200]]> : vector<3x3xf64>
  tai.store %i3, @a[%c0] : vector<3x3xf64>
  tai.store %z3, @a[%c1] : vector<3x3xf64>
  tai.store %r3, @a[%c2] : vector<3x3xf64>
  tai.store %d3, @a[%c3] : vector<3x3xf64>
  tai.store %m3, @a[%c4] : vector<3x3xf64>
  tai.store %n3, @a[%c5] : vector<3x3xf64>
  tai.store %t3, @a[%c6] : vector<3x3xf64>
  %i2 = arith.constant dense<[[1.0, 0.0], [0.0, 1.0]]> : vector<2x2xf64>
  %z2 = arith.constant dense<0.0> : vector<2x2xf64>
  %r2 = arith.constant dense<[[1.0, 2.0], [2.0, 4.0]]> : vector<2x2xf64>
  %m2 = arith.constant dense<[[-1.0, 0.0], [0.0, 1.0]]> : vector<2x2xf64>
  %n2 = arith.constant dense<[[0.0, 1.0], [1.0, 0.0]]> : vector<2x2xf64>
  tai.store %i2, @b[%c0] : vector<2x2xf64>
  tai.store %z2, @b[%c1] : vector<2x2xf64>
  tai.store %r2, @b[%c2] : vector<2x2xf64>
  tai.store %m2, @b[%c3] : vector<2x2xf64>
  tai.store %n2, @b[%c4] : vector<2x2xf64>
  tai.return
}

tai.kernel @check3() {
  %one = arith.constant 1.0 : f64
  %identity = arith.constant dense<[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]> : vector<3x3xf64>
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c3 = arith.constant 3 : index
  tai.parallel_for (%i) in @a {
    %a = tai.load @a[%i] : vector<3x3xf64>
    %u, %s, %v = tai.svd %a : vector<3x3xf64>
    %r, %p = tai.polar %a : vector<3x3xf64>
    %l, %q = tai.sym_eig %p : vector<3x3xf64> -> vector<3xf64>
    %vt = tai.transpose %v : vector<3x3xf64> -> vector<3x3xf64>
    %us = tai.matmul %u, %s : (vector<3x3xf64>, vector<3x3xf64>) -> vector<3x3xf64>
    %usv = tai.matmul %us, %vt : (vector<3x3xf64>, vector<3x3xf64>) -> vector<3x3xf64>
    %d0 = arith.subf %usv, %a : vector<3x3xf64>
    %rp = tai.matmul %r, %p : (vector<3x3xf64>, vector<3x3xf64>) -> vector<3x3xf64>
    %d1 = arith.subf %rp, %a : vector<3x3xf64>
    %ut = tai.transpose %u : vector<3x3xf64> -> vector<3x3xf64>
    %uu = tai.matmul %u, %ut : (vector<3x3xf64>, vector<3x3xf64>) -> vector<3x3xf64>
    %d2 = arith.subf %uu, %identity : vector<3x3xf64>
    %rt = tai.transpose %r : vector<3x3xf64> -> vector<3x3xf64>
    %rr = tai.matmul %r, %rt : (vector<3x3xf64>, vector<3x3xf64>) -> vector<3x3xf64>
    %d3 = arith.subf %rr, %identity : vector<3x3xf64>
    // The columns of Q are eigenvectors.
    %pq = tai.matmul %p, %q : (vector<3x3xf64>, vector<3x3xf64>) -> vector<3x3xf64>
    %ll = vector.broadcast %l : vector<3xf64> to vector<3x3xf64>
    %ql = arith.mulf %q, %ll : vector<3x3xf64>
    %d4 = arith.subf %pq, %ql : vector<3x3xf64>
    %n0 = tai.norm %d0 : vector<3x3xf64>
    %n1 = tai.norm %d1 : vector<3x3xf64>
    %n2 = tai.norm %d2 : vector<3x3xf64>
    %n3 = tai.norm %d3 : vector<3x3xf64>
    %n4 = tai.norm %d4 : vector<3x3xf64>
    %det0 = tai.determinant %u : vector<3x3xf64>
    %det1 = tai.determinant %r : vector<3x3xf64>
    %n5 = arith.subf %det0, %one : f64
    %n6 = arith.subf %det1, %one : f64
    %n7 = math.absf %n5 : f64
    %n8 = math.absf %n6 : f64
    %m0 = arith.maximumf %n0, %n1 : f64
    %m1 = arith.maximumf %n2, %n3 : f64
    %m2 = arith.maximumf %n4, %n7 : f64
    %m3 = arith.maximumf %m0, %m1 : f64
    %m4 = arith.maximumf %m2, %n8 : f64
    %m5 = arith.maximumf %m3, %m4 : f64
    %o = tai.atomic max %m5, @e3[] : f64
    // Values in descending order.
    %s0 = vector.extract %s[0, 0] : f64 from vector<3x3xf64>
    %s1 = vector.extract %s[1, 1] : f64 from vector<3x3xf64>
    %s2 = vector.extract %s[2, 2] : f64 from vector<3x3xf64>
    %abs = math.absf %s2 : f64
    %g0 = arith.subf %s1, %s0 : f64
    %g1 = arith.subf %abs, %s1 : f64
    %g = arith.maximumf %g0, %g1 : f64
    %o1 = tai.atomic max %g, @diag[] : f64
  }
  tai.return
}

tai.kernel @check2() {
  %identity = arith.constant dense<[[1.0, 0.0], [0.0, 1.0]]> : vector<2x2xf64>
  tai.parallel_for (%i) in @b {
    %a = tai.load @b[%i] : vector<2x2xf64>
    %u, %s, %v = tai.svd %a : vector<2x2xf64>
    %r, %p = tai.polar %a : vector<2x2xf64>
    %vt = tai.transpose %v : vector<2x2xf64> -> vector<2x2xf64>
    %us = tai.matmul %u, %s : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
    %usv = tai.matmul %us, %vt : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
    %d0 = arith.subf %usv, %a : vector<2x2xf64>
    %rp = tai.matmul %r, %p : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
    %d1 = arith.subf %rp, %a : vector<2x2xf64>
    %ut = tai.transpose %u : vector<2x2xf64> -> vector<2x2xf64>
    %uu = tai.matmul %u, %ut : (vector<2x2xf64>, vector<2x2xf64>) -> vector<2x2xf64>
    %d2 = arith.subf %uu, %identity : vector<2x2xf64>
    %n0 = tai.norm %d0 : vector<2x2xf64>
    %n1 = tai.norm %d1 : vector<2x2xf64>
    %n2 = tai.norm %d2 : vector<2x2xf64>
    %m0 = arith.maximumf %n0, %n1 : f64
    %m1 = arith.maximumf %m0, %n2 : f64
    %o = tai.atomic max %m1, @e2[] : f64
  }
  tai.return
}

// In single precision.
tai.kernel @check_float() {
  tai.parallel_for (%i) in @a {
    %d = tai.load @a[%i] : vector<3x3xf64>
    %a = arith.truncf %d : vector<3x3xf64> to vector<3x3xf32>
    %u, %s, %v = tai.svd %a : vector<3x3xf32>
    %vt = tai.transpose %v : vector<3x3xf32> -> vector<3x3xf32>
    %us = tai.matmul %u, %s : (vector<3x3xf32>, vector<3x3xf32>) -> vector<3x3xf32>
    %usv = tai.matmul %us, %vt : (vector<3x3xf32>, vector<3x3xf32>) -> vector<3x3xf32>
    %d0 = arith.subf %usv, %a : vector<3x3xf32>
    %n0 = tai.norm %d0 : vector<3x3xf32>
    %o = tai.atomic max %n0, @ef[] : f32
  }
  tai.return
}

// A x = b and A⁻¹ A = 1 for the random matrices.
tai.kernel @check_solve() {
  %identity = arith.constant dense<[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]> : vector<3x3xf64>
  %b = arith.constant dense<[1.0, -2.0, 0.5]> : vector<3xf64>
  %c8 = arith.constant 8 : index
  %c64 = arith.constant 64 : index
  tai.parallel_for (%i) = (%c8) to (%c64) {
    %a = tai.load @a[%i] : vector<3x3xf64>
    %x = tai.solve %a, %b : vector<3x3xf64>, vector<3xf64>
    %ax = tai.matmul %a, %x : (vector<3x3xf64>, vector<3xf64>) -> vector<3xf64>
    %d0 = arith.subf %ax, %b : vector<3xf64>
    %inverse = tai.inverse %a : vector<3x3xf64>
    %ai = tai.matmul %a, %inverse : (vector<3x3xf64>, vector<3x3xf64>) -> vector<3x3xf64>
    %d1 = arith.subf %ai, %identity : vector<3x3xf64>
    %n0 = tai.norm %d0 : vector<3xf64>
    %n1 = tai.norm %d1 : vector<3x3xf64>
    %m0 = arith.maximumf %n0, %n1 : f64
    %o = tai.atomic max %m0, @es[] : f64
  }
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai.launch @check3() : () -> ()
  tai.launch @check2() : () -> ()
  tai.launch @check_float() : () -> ()
  tai.launch @check_solve() : () -> ()
  %zero = arith.constant 0.0 : f64
  %zerof = arith.constant 0.0 : f32
  %e3 = tai.load @e3[] : f64
  %e2 = tai.load @e2[] : f64
  %ef = tai.load @ef[] : f32
  %es = tai.load @es[] : f64
  %order = tai.load @diag[] : f64
  tai_check.close %e3, %zero tolerance 3.0e-14 : f64
  tai_check.close %e2, %zero tolerance 1.0e-14 : f64
  tai_check.close %ef, %zerof tolerance 3.0e-5 : f32
  tai_check.close %es, %zero tolerance 1.0e-11 : f64
  tai_check.close %order, %zero tolerance 1.0e-15 : f64
  // The checks look at numbers that were computed, not at zeros.
  %some = arith.cmpf ogt, %e3, %zero : f64
  %one = arith.constant 1.0 : f64
  %yes = arith.select %some, %one, %zero : f64
  tai_check.close %yes, %one tolerance 0.0 : f64
  return
}
