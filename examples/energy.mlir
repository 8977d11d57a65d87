// The first program of the README, without Python:
//
//   build/bin/tai-run examples/energy.mlir --print-field=@x_grad
//
// loss = Σ sin²(xᵢ) at xᵢ = i/2; its gradient is 2 sin(xᵢ) cos(xᵢ).

tai.tree @data : !tai.root<dense<[i: 4], {x: f64}>, dense<[i: 4], {x_grad: f64}>,
                           {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : f64, rank 1
tai.field @x = @data["x"] : f64, rank 1, adjoint @x_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @energy() {
  tai.parallel_for (%i) in @x {
    %v = tai.load @x[%i] : f64
    %s = math.sin %v : f64
    %e = arith.mulf %s, %s : f64
    %old = tai.atomic add %e, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c4 = arith.constant 4 : index
  %half = arith.constant 0.5 : f64
  scf.for %i = %c0 to %c4 step %c1 {
    %n = arith.index_cast %i : index to i64
    %f = arith.sitofp %n : i64 to f64
    %v = arith.mulf %f, %half : f64
    tai.store %v, @x[%i] : f64
  }
  tai.tape loss(@loss) {
    tai.launch @energy() : () -> ()
  }
  return
}
