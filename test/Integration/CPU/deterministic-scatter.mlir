// RUN: tai-run %s --deterministic --threads=1 --print-field=@s,@g > %t.1
// RUN: tai-run %s --deterministic --threads=2 --print-field=@s,@g > %t.2
// RUN: tai-run %s --deterministic --threads=7 --print-field=@s,@g > %t.7
// RUN: diff %t.1 %t.2
// RUN: diff %t.1 %t.7
// RUN: FileCheck %s < %t.1

// Sums whose order decides their last bits come out the same for any number of
// threads: one number, and contended elements of a field and of a gradient.

tai.tree @t : !tai.root<dense<[i: 100000], {x: f32, gx: f32}>,
                        dense<[i: 5], {h: f32, gh: f32, w: f32, g: f32}>,
                        {s: f32, gs: f32}>
tai.field @gx = @t["gx"] : f32, rank 1
tai.field @x = @t["x"] : f32, rank 1, adjoint @gx
tai.field @gh = @t["gh"] : f32, rank 1
tai.field @h = @t["h"] : f32, rank 1, adjoint @gh
tai.field @g = @t["g"] : f32, rank 1
tai.field @w = @t["w"] : f32, rank 1, adjoint @g
tai.field @gs = @t["gs"] : f32, rank 0
tai.field @s = @t["s"] : f32, rank 0, adjoint @gs

tai.kernel @fill() {
  %one = arith.constant 1.0 : f32
  tai.parallel_for (%i) in @w {
    tai.store %one, @w[%i] : f32
  }
  tai.parallel_for (%i) in @x {
    %u = tai.random stream 0 : f32
    tai.store %u, @x[%i] : f32
  }
  tai.return
}

tai.kernel @histogram() {
  %c5 = arith.constant 5 : index
  tai.parallel_for (%i) in @x {
    %b = arith.remui %i, %c5 : index
    %v = tai.load @x[%i] : f32
    %w = tai.load @w[%b] : f32
    %p = arith.mulf %v, %w : f32
    %old = tai.atomic add %p, @h[%b] : f32
  }
  tai.return
}

tai.kernel @sum() {
  tai.parallel_for (%i) in @h {
    %v = tai.load @h[%i] : f32
    %q = math.sqrt %v : f32
    %old = tai.atomic add %q, @s[] : f32
  }
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai.tape loss(@s) {
    tai.launch @histogram() : () -> ()
    tai.launch @sum() : () -> ()
  }
  return
}

// About 10000 in each of five bins: the sum of roots is near 500, the gradient
// by a weight near 50.
// CHECK: @s : f32 = {{49[0-9]|50[0-9]}}.{{[0-9]+}}
// CHECK: @g : 5xf32 = [{{49|50}}.{{[0-9]+}}, {{49|50}}.
