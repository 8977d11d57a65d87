// RUN: tai-run %s --no-cache
// RUN: tai-run %s --no-cache --opt-level=0 --threads=1
// RUN: tai-run %s --no-cache --interpret
// RUN: tai-opt %s --tai-to-llvm | FileCheck %s

// Host code stands between the launches of a checked gradient: it reads and
// writes fields, and decides by what it reads.

// CHECK-LABEL: llvm.func internal @main.check0(
//       CHECK:   llvm.cond_br
//       CHECK:   llvm.call @tai_rt_host_launch(
tai.tree @t : !tai.root<dense<[i: 4], {x: f64, xg: f64, k: f64}>,
                        dense<[i: 8], {s: i32}>,
                        {l: f64, lg: f64, flag: i32}>
tai.field @x = @t["x"] : f64, rank 1, adjoint @xg
tai.field @xg = @t["xg"] : f64, rank 1
tai.field @k = @t["k"] : f64, rank 1
tai.field @s = @t["s"] : i32, rank 1
tai.field @l = @t["l"] : f64, rank 0, adjoint @lg
tai.field @lg = @t["lg"] : f64, rank 0
tai.field @flag = @t["flag"] : i32, rank 0

tai.kernel @fill() {
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %v = arith.sitofp %n : i32 to f64
    %c = arith.constant 0.3 : f64
    %w = arith.addf %v, %c : f64
    tai.store %w, @x[%i] : f64
  }
  tai.return
}
tai.kernel @square(%factor: f64) {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %k = tai.load @k[%i] : f64
    %0 = arith.mulf %x, %x : f64
    %1 = arith.mulf %0, %k : f64
    %2 = arith.mulf %1, %factor : f64
    %old = tai.atomic add %2, @l[] : f64
  }
  tai.return
}
tai.kernel @cube() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : f64
    %0 = arith.mulf %x, %x : f64
    %1 = arith.mulf %0, %x : f64
    %old = tai.atomic add %1, @l[] : f64
  }
  tai.return
}
func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %one = arith.constant 1 : i32
  %outer = tai.alloca : !tai.local<f64>
  %half = arith.constant 0.5 : f64
  tai.local_store %half, %outer : f64
  tai.launch @fill() : () -> ()
  tai.store %one, @flag[] : i32
  tai_check.gradient loss(@l) wrt [@x] tolerance 1.0e-7 {
    // Fields and locals, from inside and outside.
    scf.for %i = %c0 to %c4 step %c1 {
      %n = arith.index_cast %i : index to i32
      %v = arith.sitofp %n : i32 to f64
      %h = tai.local_load %outer : f64
      %w = arith.addf %v, %h : f64
      tai.store %w, @k[%i] : f64
    }
    tai.store %one, @s[%c5] : i32
    %other = tai.load @s[%c5] : i32
    %flag = tai.load @flag[] : i32
    %sum = arith.addi %other, %flag : i32
    %two = arith.constant 2 : i32
    %both = arith.cmpi eq, %sum, %two : i32
    scf.if %both {
      %local = tai.alloca : !tai.local<f64>
      %k = tai.load @k[%c1] : f64
      tai.local_store %k, %local : f64
      %factor = tai.local_load %local : f64
      tai.launch @square(%factor) : (f64) -> ()
    } else {
      tai.launch @cube() : () -> ()
    }
    %never = arith.cmpi eq, %flag, %two : i32
    scf.if %never {
      tai.launch @cube() : () -> ()
    }
  }
  // sum of 1.5 k 2 x: by x[2], 1.5 * 2.5 * 2 * 2.3
  %c2 = arith.constant 2 : index
  %g = tai.load @xg[%c2] : f64
  %expected = arith.constant 17.25 : f64
  tai_check.close %g, %expected tolerance 1.0e-12 : f64
  return
}
