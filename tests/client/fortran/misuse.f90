program misuse
end program
