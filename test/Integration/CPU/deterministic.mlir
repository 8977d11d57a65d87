// RUN: tai-run %s --deterministic --threads=1 --print-field=@s,@gw > %t.1
// RUN: tai-run %s --deterministic --threads=2 --print-field=@s,@gw > %t.2
// RUN: tai-run %s --deterministic --threads=7 --print-field=@s,@gw > %t.7
// RUN: diff %t.1 %t.2
// RUN: diff %t.1 %t.7
// RUN: FileCheck %s < %t.1

// Sums whose order decides their last bits come out the same for any number of
// threads, and so does the gradient, which is such a sum again.

tai.tree @t : !tai.root<dense<[i: 100000], {x: f32, gx: f32}>,
                        {s: f32, gs: f32, w: f32, gw: f32}>
tai.field @gx = @t["gx"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @gx
tai.field @gw = @t["gw"] : f32, rank 0
tai.field @w = @t["w"] : f32, rank 0, adjoint @gw
tai.field @gs = @t["gs"] : f32, rank 0
tai.field @s = @t["s"] : f32, rank 0, adjoint @gs

tai.kernel @fill() {
  %one = arith.constant 1.0 : f32
  tai.store %one, @w[] : f32
  tai.parallel_for (%i) in @x {
    %u = tai.random stream 0 : f32
    tai.store %u, @x[%i] : f32
  }
  tai.return
}

tai.kernel @sum() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f32
    %w = tai.load @w[] : f32
    %p = arith.mulf %v, %w : f32
    %q = math.sin %p : f32
    %old = tai.atomic add %q, @s[] : f32
  }
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai.tape loss(@s) {
    tai.launch @sum() : () -> ()
  }
  return
}

// The means of sin(u) and of u cos(u) for u in [0, 1): 0.4597 and 0.3818.
// CHECK: @s : f32 = 4{{5|6}}{{[0-9][0-9][0-9]}}.
// CHECK: @gw : f32 = 38{{[0-9][0-9][0-9]}}.
