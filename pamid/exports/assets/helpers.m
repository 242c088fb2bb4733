function r = least(a, b)
r = b;
if a < b
    r = a;
end
end

function r = greatest(a, b)
r = b;
if a > b
    r = a;
end
end

function r = choose(truth, a, b)
r = b;
if truth
    r = a;
end
end
