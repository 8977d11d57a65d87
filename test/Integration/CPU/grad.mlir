// RUN: tai-run %s --no-cache
// RUN: tai-run %s --no-cache --opt-level=0
// RUN: not tai-run %s --interpret 2>&1 | FileCheck %s
// CHECK: error: the interpreter does not know 'tai.grad'

// Derivatives of functions where they are used: in a host program, and in a kernel.

tai.tree @data : !tai.root<dense<[i: 1000], {x: f64, f: f64}>>
tai.field @x = @data["x"] : f64, rank 1
tai.field @f = @data["f"] : f64, rank 1

func.func private @energy(%x: f64, %k: f64) -> f64 {
  %s = math.sin %x : f64
  %q = arith.mulf %s, %x : f64
  %e = arith.mulf %k, %q : f64
  return %e : f64
}

tai.kernel @forces(%k: f64) {
  %minus = arith.constant -1.0 : f64
  %h = arith.constant 0.01 : f64
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %v = arith.sitofp %n : i32 to f64
    %x = arith.mulf %v, %h : f64
    %f = tai.grad @energy(%x, %k, %minus) wrt [0] : (f64, f64, f64) -> f64
    tai.store %x, @x[%i] : f64
    tai.store %f, @f[%i] : f64
  }
  tai.return
}

func.func @main() {
  %c100 = arith.constant 100 : index
  %k = arith.constant 2.0 : f64
  %one = arith.constant 1.0 : f64
  tai.launch @forces(%k) : (f64) -> ()
  // d/dx of 2 x sin x is 2 (sin x + x cos x), and d/dk is x sin x; at 1.
  %sin = arith.constant 0.8414709848078965 : f64
  %slope = arith.constant 2.7635465813520725 : f64
  %force = arith.constant -2.7635465813520725 : f64
  %found = tai.load @f[%c100] : f64
  tai_check.close %found, %force tolerance 1.0e-14 : f64
  %dx, %dk = tai.grad @energy(%one, %k, %one) : (f64, f64, f64) -> (f64, f64)
  tai_check.close %dx, %slope tolerance 1.0e-14 : f64
  tai_check.close %dk, %sin tolerance 1.0e-14 : f64
  return
}
