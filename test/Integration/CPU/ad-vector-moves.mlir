// RUN: tai-run %s --no-cache

// Gradients through ops that move components, and through reductions, agree with
// central differences.

tai.tree @data : !tai.root<
    dense<[i: 6], {x: vector<2x3xf64>, x_grad: vector<2x3xf64>, a: f64, a_grad: f64}>,
    {loss: f64, loss_grad: f64}>
tai.field @x_grad = @data["x_grad"] : vector<2x3xf64>, rank 1
tai.field @x = @data["x"] : vector<2x3xf64>, rank 1, adjoint @x_grad
tai.field @a_grad = @data["a_grad"] : f64, rank 1
tai.field @a = @data["a"] : f64, rank 1, adjoint @a_grad
tai.field @loss_grad = @data["loss_grad"] : f64, rank 0
tai.field @loss = @data["loss"] : f64, rank 0, adjoint @loss_grad

tai.kernel @fill() {
  %p = arith.constant dense<[[0.3, 1.1, -0.7], [0.9, -1.3, 0.4]]> : vector<2x3xf64>
  %q = arith.constant dense<[[0.13, -0.21, 0.34], [0.55, 0.08, -0.4]]> : vector<2x3xf64>
  %h = arith.constant 0.17 : f64
  tai.parallel_for (%i) in @x {
    %n = arith.index_cast %i : index to i32
    %t = arith.sitofp %n : i32 to f64
    %v = vector.broadcast %t : f64 to vector<2x3xf64>
    %m = arith.mulf %v, %q : vector<2x3xf64>
    %s = arith.addf %m, %p : vector<2x3xf64>
    tai.store %s, @x[%i] : vector<2x3xf64>
    %b = arith.mulf %t, %h : f64
    tai.store %b, @a[%i] : f64
  }
  tai.return
}

// New leading dimensions, dimensions of extent 1, and both.
tai.kernel @broadcasts() {
  %w = arith.constant dense<[[[0.3, -0.4, 0.6], [0.2, 0.9, -0.8]], [[0.1, 0.5, 0.7], [-0.2, 1.1, 0.4]]]> : vector<2x2x3xf64>
  %u = arith.constant dense<[[0.31, -0.4, 0.6], [0.25, 0.9, -0.8]]> : vector<2x3xf64>
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<2x3xf64>
    %b = vector.broadcast %x : vector<2x3xf64> to vector<2x2x3xf64>
    %p = arith.mulf %b, %b : vector<2x2x3xf64>
    %q = arith.mulf %p, %w : vector<2x2x3xf64>
    %row = vector.extract %x[1] : vector<3xf64> from vector<2x3xf64>
    %flat = vector.shape_cast %row : vector<3xf64> to vector<1x3xf64>
    %rows = vector.broadcast %flat : vector<1x3xf64> to vector<2x3xf64>
    %r = arith.mulf %rows, %u : vector<2x3xf64>
    %r2 = arith.mulf %r, %x : vector<2x3xf64>
    %c = vector.extract %x[0, 2] : f64 from vector<2x3xf64>
    %all = vector.broadcast %c : f64 to vector<2x3xf64>
    %s = arith.mulf %all, %x : vector<2x3xf64>
    %t0 = vector.shape_cast %q : vector<2x2x3xf64> to vector<12xf64>
    %t1 = vector.reduction <add>, %t0 : vector<12xf64> into f64
    %t2 = tai.sum %r2 : vector<2x3xf64>
    %t3 = tai.sum %s : vector<2x3xf64>
    %t4 = arith.addf %t1, %t2 : f64
    %t5 = arith.addf %t4, %t3 : f64
    tai.atomic add %t5, @loss[] : f64
  }
  tai.return
}

// Positions of which some are known when the kernel runs.
tai.kernel @positions(%k: index) {
  %w = arith.constant dense<[[0.31, -0.4, 0.6], [0.25, 0.9, -0.8]]> : vector<2x3xf64>
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<2x3xf64>
    %a = vector.extract %x[1, %k] : f64 from vector<2x3xf64>
    %b = arith.mulf %a, %a : f64
    %y = vector.insert %b, %x [0, %k] : f64 into vector<2x3xf64>
    %row = vector.extract %x[0] : vector<3xf64> from vector<2x3xf64>
    %square = arith.mulf %row, %row : vector<3xf64>
    %z = vector.insert %square, %y [1] : vector<3xf64> into vector<2x3xf64>
    %m = arith.mulf %z, %w : vector<2x3xf64>
    %m2 = arith.mulf %m, %z : vector<2x3xf64>
    %s = tai.sum %m2 : vector<2x3xf64>
    tai.atomic add %s, @loss[] : f64
  }
  tai.return
}

// A transpose, a shuffle of rows and one of numbers, and elements one by one.
tai.kernel @orders() {
  %w = arith.constant dense<[[0.31, -0.4], [0.6, 0.25], [0.9, -0.8]]> : vector<3x2xf64>
  %v = arith.constant dense<[[0.7, 0.2, -0.5], [0.1, 0.4, 1.2], [-0.9, 0.8, 0.3]]> : vector<3x3xf64>
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<2x3xf64>
    %a = tai.load @a[%i] : f64
    %t = vector.transpose %x, [1, 0] : vector<2x3xf64> to vector<3x2xf64>
    %t2 = arith.mulf %t, %t : vector<3x2xf64>
    %tw = arith.mulf %t2, %w : vector<3x2xf64>
    %rows = vector.shuffle %x, %x [1, 0, 3] : vector<2x3xf64>, vector<2x3xf64>
    %r2 = arith.mulf %rows, %rows : vector<3x3xf64>
    %rw = arith.mulf %r2, %v : vector<3x3xf64>
    %e:6 = vector.to_elements %x : vector<2x3xf64>
    %p = arith.mulf %e#0, %e#4 : f64
    %q = arith.mulf %p, %e#5 : f64
    %one = vector.from_elements %a, %q : vector<2xf64>
    %two = vector.from_elements %q, %a : vector<2xf64>
    %mixed = vector.shuffle %one, %two [3, 1, 0] : vector<2xf64>, vector<2xf64>
    %m2 = arith.mulf %mixed, %mixed : vector<3xf64>
    %s0 = tai.sum %tw : vector<3x2xf64>
    %s1 = tai.sum %rw : vector<3x3xf64>
    %s2 = tai.sum %m2 : vector<3xf64>
    %s3 = arith.addf %s0, %s1 : f64
    %s4 = arith.addf %s3, %s2 : f64
    tai.atomic add %s4, @loss[] : f64
  }
  tai.return
}

tai.kernel @reductions() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : vector<2x3xf64>
    %a = tai.load @a[%i] : f64
    %f = vector.shape_cast %x : vector<2x3xf64> to vector<6xf64>
    %sum = vector.reduction <add>, %f, %a : vector<6xf64> into f64
    %product = vector.reduction <mul>, %f : vector<6xf64> into f64
    %least = vector.reduction <minimumf>, %f : vector<6xf64> into f64
    %less = vector.reduction <minnumf>, %f, %a : vector<6xf64> into f64
    %most = vector.reduction <maximumf>, %f, %a : vector<6xf64> into f64
    %more = vector.reduction <maxnumf>, %f : vector<6xf64> into f64
    %first = vector.extract %f[0] : f64 from vector<6xf64>
    %single = vector.from_elements %first : vector<1xf64>
    %thrice = vector.broadcast %single : vector<1xf64> to vector<3xf64>
    %cube = vector.reduction <mul>, %thrice, %a : vector<3xf64> into f64
    %rest = arith.addf %product, %cube : f64
    %0 = arith.mulf %sum, %rest : f64
    %1 = arith.mulf %least, %most : f64
    %2 = arith.mulf %less, %more : f64
    %3 = arith.addf %0, %1 : f64
    %4 = arith.addf %3, %2 : f64
    tai.atomic add %4, @loss[] : f64
  }
  tai.return
}

func.func @main() {
  %zero = arith.constant 0.0 : f64
  %k = arith.constant 2 : index
  tai.launch @fill() : () -> ()
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @broadcasts() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @positions(%k) : (index) -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @a] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @orders() : () -> ()
  }
  tai_check.gradient loss(@loss) wrt [@x, @a] tolerance 1.0e-8 {
    tai.store %zero, @loss[] : f64
    tai.launch @reductions() : () -> ()
  }
  return
}
