// RUN: tai-run %s --print-field=@x_grad --print-field=@y | FileCheck %s

// The smallest program with a gradient: y = sum of sin(x)^2, dy/dx = sin(2 x).

tai.tree @data : !tai.root<dense<[i: 3], {x: f64, x_grad: f64}>, {y: f64, y_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @y_grad = @data["y_grad"] : f64, rank 0
tai.field @y = @data["y"] : f64, rank 0, adjoint @y_grad

tai.kernel @fill() {
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %v = arith.sitofp %n : i32 to f64
    tai.store %v, @x[%i] : f64
  }
  tai.return
}

tai.kernel @sum() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %s = math.sin %v : f64
    %q = arith.mulf %s, %s : f64
    %old = tai.atomic add %q, @y[] : f64
  }
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  tai.tape loss(@y) {
    tai.launch @sum() : () -> ()
  }
  return
}

// sin(0), sin(2), sin(4), and sin(1)^2 + sin(2)^2.
// CHECK: @x_grad : 3xf64 = [0, 0.909297426825681{{.*}}, -0.756802495307928{{.*}}]
// CHECK: @y : f64 = 1.5348952287053{{.*}}
