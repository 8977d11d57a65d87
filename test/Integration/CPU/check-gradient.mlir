// RUN: tai-run %s
// RUN: tai-run %s --deterministic --threads=1 --debug

// The gradient of a product of a matrix and a vector field, through an
// intermediate field, agrees with central differences.

tai.tree @data : !tai.root<
    dense<[i: 7], {x: vector<2xf64>, x_grad: vector<2xf64>,
                   z: vector<2xf64>, z_grad: vector<2xf64>}>,
    {a: f64, a_grad: f64, loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : vector<2xf64>, rank 1
tai.field @x = @data["x"] : vector<2xf64>, rank 1, adjoint @x_grad
tai.field @z_grad = @data["z_grad"] : vector<2xf64>, rank 1
tai.field @z = @data["z"] : vector<2xf64>, rank 1, adjoint @z_grad
tai.field @a_grad = @data["a_grad"] : f64, rank 0
tai.field @a = @data["a"] : f64, rank 0, adjoint @a_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @fill() {
  %c = arith.constant 0.25 : f64
  tai.store %c, @a[] : f64
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %v = arith.sitofp %n : i32 to f64
    %s = math.sin %v : f64
    %e = vector.from_elements %v, %s : vector<2xf64>
    tai.store %e, @x[%i] : vector<2xf64>
  }
  tai.return
}

tai.kernel @scale(%k: f64) {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : vector<2xf64>
    %a = tai.load @a[] : f64
    %ak = arith.mulf %a, %k : f64
    %b = vector.broadcast %ak : f64 to vector<2xf64>
    %p = arith.mulf %v, %b : vector<2xf64>
    %t = math.tanh %p : vector<2xf64>
    tai.store %t, @z[%i] : vector<2xf64>
  }
  tai.return
}

tai.kernel @norms() {
  tai.parallel_for (%i) in @z {
    %v = tai.load @z[%i] : vector<2xf64>
    %d = tai.dot %v, %v : vector<2xf64>
    %old = tai.atomic add %d, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  tai.launch @fill() : () -> ()
  %k = arith.constant 1.5 : f64
  tai_check.gradient loss(@loss) wrt [@x, @a] tolerance 1.0e-7 {
    %zero = arith.constant 0.0 : f64
    tai.store %zero, @loss[] : f64
    tai.launch @scale(%k) : (f64) -> ()
    tai.launch @norms() : () -> ()
  }
  return
}
