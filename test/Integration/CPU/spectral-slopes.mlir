// RUN: tai-run %s --no-cache

// U f(S) V' at equal singular values, where f is whatever the kernel computes it
// by, agrees with central differences.

!m = vector<2x2xf64>
tai.tree @t : !tai.root<{a: !m, a_grad: !m, k: f64, k_grad: f64, l: f64, l_grad: f64}>
tai.field @a_grad = @t["a_grad"] : !m, rank 0
tai.field @k_grad = @t["k_grad"] : f64, rank 0
tai.field @l_grad = @t["l_grad"] : f64, rank 0
tai.field @a = @t["a"] : !m, rank 0, adjoint @a_grad
tai.field @k = @t["k"] : f64, rank 0, adjoint @k_grad
tai.field @l = @t["l"] : f64, rank 0, adjoint @l_grad

tai.kernel @equal() {
  %c = arith.constant dense<[[1.2, 0.0], [0.0, 1.2]]> : !m
  %k = arith.constant 0.7 : f64
  tai.store %c, @a[] : !m
  tai.store %k, @k[] : f64
  tai.return
}
tai.kernel @apart() {
  %c = arith.constant dense<[[1.2, 0.3], [-0.4, 0.8]]> : !m
  tai.store %c, @a[] : !m
  tai.return
}

// A loop on the one value, and a branch on the other.
tai.kernel @loop_and_branch(%n: index) {
  %zero = arith.constant 0.0 : f64
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %w = arith.constant dense<[[0.3, 0.7], [1.1, -0.6]]> : !m
  %a = tai.load @a[] : !m
  %u, %s, %v = tai.svd %a : !m
  %s0 = vector.extract %s[0, 0] : f64 from !m
  %s1 = vector.extract %s[1, 1] : f64 from !m
  %m0 = scf.for %i = %c0 to %n step %c1 iter_args(%p = %s0) -> f64 {
    %q = arith.mulf %p, %s0 : f64
    scf.yield %q : f64
  }
  %positive = arith.cmpf ogt, %s1, %zero : f64
  %m1 = scf.if %positive -> f64 {
    %q = scf.for %i = %c0 to %n step %c1 iter_args(%p = %s1) -> f64 {
      %r = arith.mulf %p, %s1 : f64
      scf.yield %r : f64
    }
    scf.yield %q : f64
  } else {
    scf.yield %s1 : f64
  }
  %m = vector.from_elements %m0, %zero, %zero, %m1 : !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  %3 = arith.mulf %2, %w : !m
  %4 = tai.sum %3 : !m
  tai.atomic add %4, @l[] : f64
  tai.return
}

// Numbers from elsewhere: one that has a derivative, an argument and an integer;
// and numbers that the product is times.
tai.kernel @from_elsewhere(%e: f64, %n: i32) {
  %zero = arith.constant 0.0 : f64
  %w = arith.constant dense<[[0.3, 0.7], [1.1, -0.6]]> : !m
  %two = arith.constant dense<2.0> : !m
  %a = tai.load @a[] : !m
  %k = tai.load @k[] : f64
  %u, %s, %v = tai.svd %a : !m
  %s0 = vector.extract %s[0, 0] : f64 from !m
  %s1 = vector.extract %s[1, 1] : f64 from !m
  %f = arith.sitofp %n : i32 to f64
  %k0 = arith.mulf %s0, %k : f64
  %e0 = math.powf %s0, %e : f64
  %f0 = arith.mulf %e0, %f : f64
  %m0 = arith.addf %k0, %f0 : f64
  %k1 = arith.mulf %s1, %k : f64
  %e1 = math.powf %s1, %e : f64
  %f1 = arith.mulf %e1, %f : f64
  %m1 = arith.addf %k1, %f1 : f64
  %m = vector.from_elements %m0, %zero, %zero, %m1 : !m
  %u2 = arith.mulf %two, %u : !m
  %0 = tai.matmul %u2, %m : (!m, !m) -> !m
  %b = vector.broadcast %k : f64 to !m
  %scaled = arith.mulf %0, %b : !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %scaled, %1 : (!m, !m) -> !m
  %3 = arith.mulf %2, %w : !m
  %4 = tai.sum %3 : !m
  tai.atomic add %4, @l[] : f64
  tai.return
}

// The rotation alone, with a diagonal that does not depend on the matrix; and one
// made by inserts, sums, differences, quotients and products of diagonals.
tai.kernel @constant_diagonal(%x: f64) {
  %zero = arith.constant 0.0 : f64
  %w = arith.constant dense<[[0.3, 0.7], [1.1, -0.6]]> : !m
  %a = tai.load @a[] : !m
  %u, %s, %v = tai.svd %a : !m
  %m = vector.from_elements %x, %zero, %zero, %x : !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  %3 = arith.mulf %2, %w : !m
  %4 = tai.sum %3 : !m
  tai.atomic add %4, @l[] : f64
  tai.return
}
tai.kernel @composed(%c: i1) {
  %w = arith.constant dense<[[0.3, 0.7], [1.1, -0.6]]> : !m
  %full = arith.constant dense<[[1.3, 0.7], [1.1, 1.6]]> : !m
  %one = arith.constant dense<[[1.0, 0.0], [0.0, 1.0]]> : !m
  %a = tai.load @a[] : !m
  %u, %s, %v = tai.svd %a : !m
  %squared = tai.matmul %s, %s : (!m, !m) -> !m
  %d = arith.subf %squared, %one : !m
  %e = arith.mulf %full, %d : !m
  %n = arith.negf %e : !m
  %q = arith.divf %n, %full : !m
  %i = tai.inverse %s : !m
  %t = tai.transpose %i : !m -> !m
  %sum = arith.addf %q, %t : !m
  %m = arith.select %c, %sum, %s : !m
  %0 = tai.matmul %u, %m : (!m, !m) -> !m
  %1 = tai.transpose %v : !m -> !m
  %2 = tai.matmul %0, %1 : (!m, !m) -> !m
  %3 = arith.mulf %2, %w : !m
  %4 = tai.sum %3 : !m
  tai.atomic add %4, @l[] : f64
  tai.return
}

func.func @main() {
  %zero = arith.constant 0.0 : f64
  %c2 = arith.constant 2 : index
  %n = arith.constant 3 : i32
  %e = arith.constant 1.5 : f64
  %true = arith.constant true
  tai.launch @equal() : () -> ()
  tai_check.gradient loss(@l) wrt [@a] tolerance 1.0e-6 {
    tai.store %zero, @l[] : f64
    tai.launch @loop_and_branch(%c2) : (index) -> ()
  }
  tai_check.gradient loss(@l) wrt [@a, @k] tolerance 1.0e-6 {
    tai.store %zero, @l[] : f64
    tai.launch @from_elsewhere(%e, %n) : (f64, i32) -> ()
  }
  tai_check.gradient loss(@l) wrt [@a] tolerance 1.0e-6 {
    tai.store %zero, @l[] : f64
    tai.launch @constant_diagonal(%e) : (f64) -> ()
  }
  tai_check.gradient loss(@l) wrt [@a] tolerance 1.0e-6 {
    tai.store %zero, @l[] : f64
    tai.launch @composed(%true) : (i1) -> ()
  }
  tai.launch @apart() : () -> ()
  tai_check.gradient loss(@l) wrt [@a] tolerance 1.0e-7 {
    tai.store %zero, @l[] : f64
    tai.launch @loop_and_branch(%c2) : (index) -> ()
  }
  tai_check.gradient loss(@l) wrt [@a, @k] tolerance 1.0e-7 {
    tai.store %zero, @l[] : f64
    tai.launch @from_elsewhere(%e, %n) : (f64, i32) -> ()
  }
  tai_check.gradient loss(@l) wrt [@a] tolerance 1.0e-7 {
    tai.store %zero, @l[] : f64
    tai.launch @constant_diagonal(%e) : (f64) -> ()
  }
  tai_check.gradient loss(@l) wrt [@a] tolerance 1.0e-7 {
    tai.store %zero, @l[] : f64
    tai.launch @composed(%true) : (i1) -> ()
  }
  return
}
